/* The public interface of libusb-1.0, as far as libfreenect and pyusb use it.
 *
 * Layouts and numbers are those of the documented interface (libusb.sourceforge.io/api-1.0), so
 * that programs built against the real library run on this one.
 */
#ifndef LIBUSB_ABI_H
#define LIBUSB_ABI_H

#include <stdint.h>
#include <sys/time.h>
#include <sys/types.h>

enum {
    LIBUSB_SUCCESS = 0,
    LIBUSB_ERROR_IO = -1,
    LIBUSB_ERROR_INVALID_PARAM = -2,
    LIBUSB_ERROR_ACCESS = -3,
    LIBUSB_ERROR_NO_DEVICE = -4,
    LIBUSB_ERROR_NOT_FOUND = -5,
    LIBUSB_ERROR_BUSY = -6,
    LIBUSB_ERROR_TIMEOUT = -7,
    LIBUSB_ERROR_OVERFLOW = -8,
    LIBUSB_ERROR_PIPE = -9,
    LIBUSB_ERROR_INTERRUPTED = -10,
    LIBUSB_ERROR_NO_MEM = -11,
    LIBUSB_ERROR_NOT_SUPPORTED = -12,
    LIBUSB_ERROR_OTHER = -99,
};

enum libusb_transfer_status {
    LIBUSB_TRANSFER_COMPLETED,
    LIBUSB_TRANSFER_ERROR,
    LIBUSB_TRANSFER_TIMED_OUT,
    LIBUSB_TRANSFER_CANCELLED,
    LIBUSB_TRANSFER_STALL,
    LIBUSB_TRANSFER_NO_DEVICE,
    LIBUSB_TRANSFER_OVERFLOW,
};

enum { LIBUSB_TRANSFER_TYPE_CONTROL, LIBUSB_TRANSFER_TYPE_ISOCHRONOUS, LIBUSB_TRANSFER_TYPE_BULK,
       LIBUSB_TRANSFER_TYPE_INTERRUPT };
enum { LIBUSB_TRANSFER_FREE_TRANSFER = 1 << 2 };
enum { LIBUSB_SPEED_FULL = 2, LIBUSB_SPEED_HIGH = 3 };
enum { LIBUSB_DT_CONFIG = 2, LIBUSB_DT_DEVICE = 1, LIBUSB_DT_STRING = 3, LIBUSB_DT_INTERFACE = 4,
       LIBUSB_DT_ENDPOINT = 5 };

typedef struct libusb_context libusb_context;
typedef struct libusb_device libusb_device;
typedef struct libusb_device_handle libusb_device_handle;
struct libusb_transfer;
typedef void (*libusb_transfer_cb_fn)(struct libusb_transfer *transfer);

struct libusb_iso_packet_descriptor {
    unsigned int length;
    unsigned int actual_length;
    enum libusb_transfer_status status;
};

struct libusb_transfer {
    libusb_device_handle *dev_handle;
    uint8_t flags;
    unsigned char endpoint;
    unsigned char type;
    unsigned int timeout;
    enum libusb_transfer_status status;
    int length;
    int actual_length;
    libusb_transfer_cb_fn callback;
    void *user_data;
    unsigned char *buffer;
    int num_iso_packets;
    struct libusb_iso_packet_descriptor iso_packet_desc[];
};

struct libusb_device_descriptor {
    uint8_t bLength, bDescriptorType;
    uint16_t bcdUSB;
    uint8_t bDeviceClass, bDeviceSubClass, bDeviceProtocol, bMaxPacketSize0;
    uint16_t idVendor, idProduct, bcdDevice;
    uint8_t iManufacturer, iProduct, iSerialNumber, bNumConfigurations;
};

struct libusb_endpoint_descriptor {
    uint8_t bLength, bDescriptorType, bEndpointAddress, bmAttributes;
    uint16_t wMaxPacketSize;
    uint8_t bInterval, bRefresh, bSynchAddress;
    const unsigned char *extra;
    int extra_length;
};

struct libusb_interface_descriptor {
    uint8_t bLength, bDescriptorType, bInterfaceNumber, bAlternateSetting, bNumEndpoints,
        bInterfaceClass, bInterfaceSubClass, bInterfaceProtocol, iInterface;
    const struct libusb_endpoint_descriptor *endpoint;
    const unsigned char *extra;
    int extra_length;
};

struct libusb_interface {
    const struct libusb_interface_descriptor *altsetting;
    int num_altsetting;
};

struct libusb_config_descriptor {
    uint8_t bLength, bDescriptorType;
    uint16_t wTotalLength;
    uint8_t bNumInterfaces, bConfigurationValue, iConfiguration, bmAttributes, MaxPower;
    const struct libusb_interface *interface;
    const unsigned char *extra;
    int extra_length;
};

struct libusb_version {
    uint16_t major, minor, micro, nano;
    const char *rc, *describe;
};

#pragma GCC visibility push(default)
int libusb_init(libusb_context **context);
void libusb_exit(libusb_context *context);
void libusb_set_debug(libusb_context *context, int level);
int libusb_set_option(libusb_context *context, int option, ...);
int libusb_has_capability(uint32_t capability);
const struct libusb_version *libusb_get_version(void);
const char *libusb_error_name(int code);
const char *libusb_strerror(int code);
int libusb_hotplug_register_callback(libusb_context *context, ...);
void libusb_hotplug_deregister_callback(libusb_context *context, int callback_handle);

ssize_t libusb_get_device_list(libusb_context *context, libusb_device ***list);
void libusb_free_device_list(libusb_device **list, int unref_devices);
libusb_device *libusb_ref_device(libusb_device *device);
void libusb_unref_device(libusb_device *device);
libusb_device *libusb_get_parent(libusb_device *device);
uint8_t libusb_get_bus_number(libusb_device *device);
uint8_t libusb_get_device_address(libusb_device *device);
uint8_t libusb_get_port_number(libusb_device *device);
int libusb_get_port_numbers(libusb_device *device, uint8_t *ports, int room);
int libusb_get_device_speed(libusb_device *device);
int libusb_get_device_descriptor(libusb_device *device, struct libusb_device_descriptor *out);
int libusb_get_config_descriptor(libusb_device *device, uint8_t index,
                                 struct libusb_config_descriptor **out);
int libusb_get_active_config_descriptor(libusb_device *device,
                                        struct libusb_config_descriptor **out);
void libusb_free_config_descriptor(struct libusb_config_descriptor *config);
int libusb_get_max_packet_size(libusb_device *device, unsigned char endpoint);
int libusb_get_max_iso_packet_size(libusb_device *device, unsigned char endpoint);

int libusb_open(libusb_device *device, libusb_device_handle **out);
libusb_device_handle *libusb_open_device_with_vid_pid(libusb_context *context, uint16_t vendor,
                                                      uint16_t product);
void libusb_close(libusb_device_handle *handle);
libusb_device *libusb_get_device(libusb_device_handle *handle);
int libusb_get_configuration(libusb_device_handle *handle, int *configuration);
int libusb_set_configuration(libusb_device_handle *handle, int configuration);
int libusb_claim_interface(libusb_device_handle *handle, int number);
int libusb_release_interface(libusb_device_handle *handle, int number);
int libusb_set_interface_alt_setting(libusb_device_handle *handle, int number, int alternate);
int libusb_clear_halt(libusb_device_handle *handle, unsigned char endpoint);
int libusb_reset_device(libusb_device_handle *handle);
int libusb_kernel_driver_active(libusb_device_handle *handle, int number);
int libusb_detach_kernel_driver(libusb_device_handle *handle, int number);
int libusb_attach_kernel_driver(libusb_device_handle *handle, int number);
int libusb_set_auto_detach_kernel_driver(libusb_device_handle *handle, int enable);
int libusb_get_string_descriptor_ascii(libusb_device_handle *handle, uint8_t index,
                                       unsigned char *text, int room);

int libusb_control_transfer(libusb_device_handle *handle, uint8_t type, uint8_t request,
                            uint16_t value, uint16_t index, unsigned char *data, uint16_t length,
                            unsigned int timeout_ms);
int libusb_bulk_transfer(libusb_device_handle *handle, unsigned char endpoint,
                         unsigned char *data, int length, int *transferred,
                         unsigned int timeout_ms);
int libusb_interrupt_transfer(libusb_device_handle *handle, unsigned char endpoint,
                              unsigned char *data, int length, int *transferred,
                              unsigned int timeout_ms);

struct libusb_transfer *libusb_alloc_transfer(int iso_packets);
void libusb_free_transfer(struct libusb_transfer *transfer);
int libusb_submit_transfer(struct libusb_transfer *transfer);
int libusb_cancel_transfer(struct libusb_transfer *transfer);
int libusb_handle_events(libusb_context *context);
int libusb_handle_events_completed(libusb_context *context, int *completed);
int libusb_handle_events_timeout(libusb_context *context, struct timeval *timeout);
int libusb_handle_events_timeout_completed(libusb_context *context, struct timeval *timeout,
                                           int *completed);
#pragma GCC visibility pop

#endif
