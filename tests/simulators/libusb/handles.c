/* Device handles: permissions, claimed interfaces, and the kernel driver. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "simulator.h"

enum { CLAIMS_A_FUNCTION = 8 };

/* Lock or unlock one byte of the control file while `file` is open. The locks belong to the open
 * file, as the kernel's claims belong to the open device: two handles of one process exclude each
 * other, and a killed process leaves no locks. */
static bool lock_byte(int file, short type, off_t at)
{
    struct flock lock = {.l_type = type, .l_whence = SEEK_SET, .l_start = at, .l_len = 1};
    return fcntl(file, F_OFD_SETLK, &lock) == 0;
}

static off_t claim_of(const struct libusb_device_handle *handle, int interface)
{
    return LOCKS_CLAIMS + (off_t)handle->device->function * CLAIMS_A_FUNCTION + interface;
}

bool is_gone(const struct libusb_device_handle *handle)
{
    const volatile struct control *control = handle->device->kinect->control;
    return !control->plugged || control->generation != handle->device->generation;
}

static int may_open(const struct libusb_device *device)
{
    if (device->function <= KINECT_HUB)
        return LIBUSB_ERROR_ACCESS; /* hubs belong to the system */
    const volatile struct control *control = device->kinect->control;
    if (!control->plugged || control->generation != device->generation)
        return LIBUSB_ERROR_NO_DEVICE;
    return control->forbidden ? LIBUSB_ERROR_ACCESS : LIBUSB_SUCCESS;
}

int libusb_open(libusb_device *device, libusb_device_handle **out)
{
    int refusal = may_open(device);
    if (refusal)
        return refusal;
    struct libusb_device_handle *handle = calloc(1, sizeof *handle);
    if (!handle)
        return LIBUSB_ERROR_NO_MEM;
    handle->file = open(device->kinect->path, O_RDWR | O_CLOEXEC);
    if (handle->file < 0) {
        free(handle);
        return LIBUSB_ERROR_NO_DEVICE;
    }
    int slot = 0;
    while (slot < OPEN_HANDLE_SLOTS && !lock_byte(handle->file, F_WRLCK, LOCKS_OPEN_HANDLES + slot))
        slot++;
    handle->device = libusb_ref_device(device);
    pthread_mutex_lock(&bus_mutex);
    handle->next = device->context->handles;
    device->context->handles = handle;
    pthread_mutex_unlock(&bus_mutex);
    *out = handle;
    return LIBUSB_SUCCESS;
}

libusb_device_handle *libusb_open_device_with_vid_pid(libusb_context *context, uint16_t vendor,
                                                      uint16_t product)
{
    libusb_device **list, **device;
    libusb_device_handle *handle = NULL;
    struct libusb_device_descriptor descriptor;
    if (libusb_get_device_list(context, &list) < 0)
        return NULL;
    for (device = list; *device && !handle; device++) {
        libusb_get_device_descriptor(*device, &descriptor);
        if (descriptor.idVendor == vendor && descriptor.idProduct == product)
            libusb_open(*device, &handle);
    }
    libusb_free_device_list(list, 1);
    return handle;
}

void libusb_close(libusb_device_handle *handle)
{
    if (!handle)
        return;
    drop_transfers(handle);
    pthread_mutex_lock(&bus_mutex);
    struct libusb_device_handle **link = &handle->device->context->handles;
    while (*link != handle)
        link = &(*link)->next;
    *link = handle->next;
    pthread_mutex_unlock(&bus_mutex);
    close(handle->file);
    libusb_unref_device(handle->device);
    free(handle);
}

libusb_device *libusb_get_device(libusb_device_handle *handle) { return handle->device; }

int libusb_get_configuration(libusb_device_handle *handle, int *configuration)
{
    *configuration = 1;
    return is_gone(handle) ? LIBUSB_ERROR_NO_DEVICE : LIBUSB_SUCCESS;
}

int libusb_set_configuration(libusb_device_handle *handle, int configuration)
{
    if (is_gone(handle))
        return LIBUSB_ERROR_NO_DEVICE;
    return configuration == 1 ? LIBUSB_SUCCESS : LIBUSB_ERROR_NOT_FOUND;
}

int libusb_claim_interface(libusb_device_handle *handle, int number)
{
    const volatile struct control *control = handle->device->kinect->control;
    bool camera = handle->device->function == CAMERA;
    if (is_gone(handle))
        return LIBUSB_ERROR_NO_DEVICE;
    if (camera && (control->busy || control->kernel_driver))
        return LIBUSB_ERROR_BUSY;
    return lock_byte(handle->file, F_WRLCK, claim_of(handle, number)) ? LIBUSB_SUCCESS
                                                                      : LIBUSB_ERROR_BUSY;
}

int libusb_release_interface(libusb_device_handle *handle, int number)
{
    lock_byte(handle->file, F_UNLCK, claim_of(handle, number));
    return is_gone(handle) ? LIBUSB_ERROR_NO_DEVICE : LIBUSB_SUCCESS;
}

int libusb_set_interface_alt_setting(libusb_device_handle *handle, int number, int alternate)
{
    (void)number;
    if (is_gone(handle))
        return LIBUSB_ERROR_NO_DEVICE;
    handle->alternate = alternate;
    return LIBUSB_SUCCESS;
}

int libusb_clear_halt(libusb_device_handle *handle, unsigned char endpoint)
{
    (void)endpoint;
    return is_gone(handle) ? LIBUSB_ERROR_NO_DEVICE : LIBUSB_SUCCESS;
}

int libusb_reset_device(libusb_device_handle *handle)
{
    handle->audio_reply_count = 0;
    return is_gone(handle) ? LIBUSB_ERROR_NO_DEVICE : LIBUSB_SUCCESS;
}

int libusb_kernel_driver_active(libusb_device_handle *handle, int number)
{
    const volatile struct control *control = handle->device->kinect->control;
    if (is_gone(handle))
        return LIBUSB_ERROR_NO_DEVICE;
    return handle->device->function == CAMERA && number == 0 && control->kernel_driver;
}

int libusb_detach_kernel_driver(libusb_device_handle *handle, int number)
{
    int active = libusb_kernel_driver_active(handle, number);
    if (active <= 0)
        return active < 0 ? active : LIBUSB_ERROR_NOT_FOUND;
    handle->device->kinect->control->kernel_driver = 0;
    handle->detached_driver = true;
    return LIBUSB_SUCCESS;
}

int libusb_attach_kernel_driver(libusb_device_handle *handle, int number)
{
    (void)number;
    if (is_gone(handle))
        return LIBUSB_ERROR_NO_DEVICE;
    if (!handle->detached_driver)
        return LIBUSB_ERROR_NOT_FOUND;
    handle->device->kinect->control->kernel_driver = 1;
    handle->detached_driver = false;
    return LIBUSB_SUCCESS;
}

int libusb_set_auto_detach_kernel_driver(libusb_device_handle *handle, int enable)
{
    (void)handle, (void)enable;
    return LIBUSB_ERROR_NOT_SUPPORTED;
}

int libusb_get_string_descriptor_ascii(libusb_device_handle *handle, uint8_t index,
                                       unsigned char *text, int room)
{
    const char *string = string_of(handle->device, index);
    if (is_gone(handle))
        return LIBUSB_ERROR_NO_DEVICE;
    if (!string || room < 1)
        return LIBUSB_ERROR_INVALID_PARAM;
    int length = (int)strnlen(string, (size_t)room - 1);
    memcpy(text, string, (size_t)length);
    text[length] = 0;
    return length;
}
