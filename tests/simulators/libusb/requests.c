/* Blocking transfers: control and bulk. */
#include <string.h>

#include "simulator.h"

enum { IN = 0x80, STANDARD_DEVICE_IN = 0x80, VENDOR_IN = 0xc0, VENDOR_OUT = 0x40 };
enum { GET_DESCRIPTOR = 0x06, ENGLISH = 0x0409 };
enum { BULK_OUT = 0x01, BULK_IN = 0x81 };
/* A control transfer takes a few microframes, even for a program that polls without pause. */
enum { CONTROL_TRANSFER_NS = 2 * MICROFRAME_NS, BULK_POLL_NS = 1000000, NS_PER_MS = 1000000 };
/* A transfer without a timeout would wait forever; tests must not. */
enum { FOR_EVER_MS = 60000 };

/* A string descriptor is UTF-16; number 0 lists the languages. */
static int string_descriptor(const struct libusb_device *device, uint8_t index, uint8_t *data,
                             int room)
{
    uint8_t descriptor[2 + 2 * SERIAL_ROOM] = {2, LIBUSB_DT_STRING};
    const char *string = index ? string_of(device, index) : "";
    if (!string)
        return LIBUSB_ERROR_PIPE;
    for (; *string && descriptor[0] < sizeof descriptor; string++, descriptor[0] += 2)
        put16(descriptor + descriptor[0], (uint8_t)*string);
    if (index == 0) {
        put16(descriptor + 2, ENGLISH);
        descriptor[0] = 4;
    }
    int bytes = descriptor[0] < room ? descriptor[0] : room;
    memcpy(data, descriptor, (size_t)bytes);
    return bytes;
}

static int control_out(struct libusb_device_handle *handle, uint8_t request, uint16_t value,
                       const uint8_t *data, int length)
{
    if (handle->device->function == MOTOR)
        return motor_request(handle->device->kinect, request, value);
    if (handle->device->function != CAMERA)
        return LIBUSB_ERROR_PIPE;
    camera_request(handle, data, length);
    return length;
}

static int control_in(struct libusb_device_handle *handle, uint8_t request, uint8_t *data,
                      int room)
{
    if (handle->device->function == MOTOR)
        return motor_answer(handle->device->kinect, request, data, room);
    if (handle->device->function == CAMERA)
        return camera_answer(handle, data, room);
    return LIBUSB_ERROR_PIPE;
}

/* Error of a transfer that is impossible, else 0. */
static int refusal_of(const struct libusb_device_handle *handle)
{
    if (in_a_callback())
        return LIBUSB_ERROR_BUSY;
    return is_gone(handle) ? LIBUSB_ERROR_NO_DEVICE : LIBUSB_SUCCESS;
}

int libusb_control_transfer(libusb_device_handle *handle, uint8_t type, uint8_t request,
                            uint16_t value, uint16_t index, unsigned char *data, uint16_t length,
                            unsigned int timeout_ms)
{
    (void)index, (void)timeout_ms;
    if (in_a_callback())
        return LIBUSB_ERROR_BUSY;
    spend_time_on_the_bus(handle->device->context, CONTROL_TRANSFER_NS);
    int refusal = refusal_of(handle);
    if (refusal)
        return refusal;
    if (type == STANDARD_DEVICE_IN && request == GET_DESCRIPTOR && value >> 8 == LIBUSB_DT_STRING)
        return string_descriptor(handle->device, (uint8_t)value, data, length);
    if (type == VENDOR_OUT)
        return control_out(handle, request, value, data, length);
    if (type == VENDOR_IN)
        return control_in(handle, request, data, length);
    return LIBUSB_ERROR_PIPE;
}

static int bulk_in(struct libusb_device_handle *handle, unsigned char *data, int room,
                   int *transferred, unsigned timeout_ms)
{
    uint64_t wait_ns = (uint64_t)(timeout_ms ? timeout_ms : FOR_EVER_MS) * NS_PER_MS;
    uint64_t deadline_ns = now_ns() + wait_ns;
    while ((*transferred = audio_answer(handle, data, room)) == 0) {
        if (now_ns() >= deadline_ns)
            return LIBUSB_ERROR_TIMEOUT;
        spend_time_on_the_bus(handle->device->context, BULK_POLL_NS);
        if (is_gone(handle))
            return LIBUSB_ERROR_NO_DEVICE;
    }
    return LIBUSB_SUCCESS;
}

int libusb_bulk_transfer(libusb_device_handle *handle, unsigned char endpoint,
                         unsigned char *data, int length, int *transferred,
                         unsigned int timeout_ms)
{
    int counted;
    int *count = transferred ? transferred : &counted;
    int refusal = refusal_of(handle);
    *count = 0;
    if (refusal)
        return refusal;
    if (handle->device->function != AUDIO || (endpoint != BULK_OUT && endpoint != BULK_IN))
        return LIBUSB_ERROR_NOT_FOUND;
    spend_time_on_the_bus(handle->device->context, CONTROL_TRANSFER_NS);
    if (endpoint == BULK_IN)
        return bulk_in(handle, data, length, count, timeout_ms);
    audio_command(handle, data, length);
    *count = length;
    return LIBUSB_SUCCESS;
}

int libusb_interrupt_transfer(libusb_device_handle *handle, unsigned char endpoint,
                              unsigned char *data, int length, int *transferred,
                              unsigned int timeout_ms)
{
    (void)handle, (void)endpoint, (void)data, (void)length, (void)timeout_ms;
    *transferred = 0;
    return LIBUSB_ERROR_NOT_FOUND;
}
