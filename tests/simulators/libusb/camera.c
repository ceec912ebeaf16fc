/* The camera's control protocol: registers, calibration, the color sensor's own registers.
 *
 * A command is "GM", half its length, its number and a tag. The host reads the reply by a second
 * transfer; it begins with "RB", half its length, the same number and tag.
 */
#include <string.h>

#include "simulator.h"

enum command {
    READ_REGISTER = 0x02,
    WRITE_REGISTER = 0x03,
    FIXED_PARAMETERS = 0x04,
    ALGORITHM_PARAMETERS = 0x16,
    CMOS_REGISTER = 0x95,
};
enum parameter { PARAMETER_CONST_SHIFT = 0x00, PARAMETER_REGISTRATION = 0x40,
                 PARAMETER_PADDING = 0x41 };
enum { HEADER_BYTES = 8, STATUS_BYTES = 2 };
enum { FIXED_BYTES_1414 = 322, FIXED_BYTES_LATER = 334, ZERO_PLANE_AT = 94 };
enum { CMOS_WRITE = 0x8000 };
enum { REGISTER_VIDEO = 0x05, REGISTER_DEPTH = 0x06 };

static void write_register(struct kinect *kinect, uint16_t number, uint16_t value)
{
    volatile struct control *control = kinect->control;
    uint16_t before = control->registers[number];
    control->registers[number] = value;
    if (before == 0 && value != 0 && number == REGISTER_DEPTH)
        stream_switched_on(kinect, DEPTH);
    if (before == 0 && value != 0 && number == REGISTER_VIDEO)
        stream_switched_on(kinect, VIDEO);
}

static int algorithm_parameter(const volatile struct control *control, uint16_t number,
                               uint8_t *answer)
{
    uint8_t *at = answer + STATUS_BYTES;
    if (number == PARAMETER_CONST_SHIFT) {
        put16(at, control->const_shift);
        at += 2;
    } else if (number == PARAMETER_PADDING) {
        for (int i = 0; i < 3; i++, at += 2)
            put16(at, control->padding[i]);
    } else if (number == PARAMETER_REGISTRATION) {
        for (int i = 0; i < 29; i++, at += 4)
            put32(at, (uint32_t)control->registration[i]);
    }
    return (int)(at - answer);
}

static int fixed_parameters(const volatile struct control *control, uint8_t *answer)
{
    for (int i = 0; i < 4; i++) {
        float value = control->zero_plane[i];
        uint32_t bits;
        memcpy(&bits, &value, sizeof bits);
        put32(answer + ZERO_PLANE_AT + 4 * i, bits);
    }
    return control->model == MODEL_1414 ? FIXED_BYTES_1414 : FIXED_BYTES_LATER;
}

static int cmos_register(volatile struct control *control, const uint8_t *data, uint8_t *answer)
{
    uint16_t number = get16(data + 2);
    volatile uint16_t *value = &control->cmos[number % CMOS_REGISTERS];
    if (number & CMOS_WRITE)
        *value = get16(data + 4);
    put16(answer, get16(data));
    put16(answer + 2, number);
    put16(answer + 4, *value);
    return 6;
}

/* Bytes of the reply to a command with at least six bytes of data. */
static int answer_to(struct kinect *kinect, uint16_t command, const uint8_t *data, uint8_t *answer)
{
    volatile struct control *control = kinect->control;
    uint16_t number = get16(data) % CAMERA_REGISTERS;
    switch (command) {
    case READ_REGISTER:
        put16(answer, number);
        put16(answer + 2, control->registers[number]);
        return 4;
    case WRITE_REGISTER:
        write_register(kinect, number, get16(data + 2));
        return STATUS_BYTES;
    case FIXED_PARAMETERS:
        return fixed_parameters(control, answer);
    case ALGORITHM_PARAMETERS:
        return algorithm_parameter(control, get16(data), answer);
    case CMOS_REGISTER:
        return cmos_register(control, data, answer);
    default:
        return STATUS_BYTES;
    }
}

void camera_request(struct libusb_device_handle *handle, const uint8_t *data, int length)
{
    uint8_t message[HEADER_BYTES + 16] = {0};
    struct reply *reply = &handle->camera_reply;
    memcpy(message, data, (size_t)(length < (int)sizeof message ? length : (int)sizeof message));
    uint16_t command = get16(message + 4), tag = get16(message + 6);
    memset(reply, 0, sizeof *reply);
    if (message[0] != 'G' || message[1] != 'M')
        return;
    int bytes = answer_to(handle->device->kinect, command, message + HEADER_BYTES,
                          reply->bytes + HEADER_BYTES);
    reply->bytes[0] = 'R';
    reply->bytes[1] = 'B';
    put16(reply->bytes + 2, (uint16_t)(bytes / 2));
    put16(reply->bytes + 4, command);
    put16(reply->bytes + 6, tag);
    reply->length = HEADER_BYTES + bytes;
}

/* No bytes: there is no reply yet. A camera whose firmware hangs never replies. */
int camera_answer(struct libusb_device_handle *handle, uint8_t *data, int room)
{
    struct reply *reply = &handle->camera_reply;
    if (handle->device->kinect->control->frozen)
        return 0;
    int bytes = reply->length < room ? reply->length : room;
    memcpy(data, reply->bytes, (size_t)bytes);
    reply->length = 0;
    return bytes;
}
