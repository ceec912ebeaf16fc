/* Descriptors of a Kinect's devices: identity, strings, interfaces, endpoints. */
#include <stdlib.h>
#include <string.h>

#include "simulator.h"

enum { VENDOR_MICROSOFT = 0x045e, VENDOR_NEC = 0x0409, VENDOR_LINUX = 0x1d6b };
enum { STRING_PRODUCT = 1, STRING_MANUFACTURER = 2, STRING_SERIAL = 3 };
enum { CLASS_HUB = 9, CLASS_VENDOR = 0xff };
enum { TYPE_ISOCHRONOUS = 1, TYPE_BULK = 2 };

struct product {
    uint16_t vendor, product, release;
    uint8_t class;
    const char *name;
};

static const struct product *product_of(const struct libusb_device *device)
{
    static const struct product root_hub = {VENDOR_LINUX, 0x0002, 0x0515, CLASS_HUB,
                                            "EHCI Host Controller"};
    /* The release number of the camera distinguishes a 1414 from a 1473. */
    static const struct product products[3][AUDIO + 1] = {
        [MODEL_1414] = {
            [KINECT_HUB] = {VENDOR_NEC, 0x005a, 0x0100, CLASS_HUB, "Hub"},
            [CAMERA] = {VENDOR_MICROSOFT, 0x02ae, 0x010b, 0, "Xbox NUI Camera"},
            [MOTOR] = {VENDOR_MICROSOFT, 0x02b0, 0x0105, 0, "Xbox NUI Motor"},
            [AUDIO] = {VENDOR_MICROSOFT, 0x02ad, 0x0100, 0, "Xbox NUI Audio"},
        },
        [MODEL_1473] = {
            [KINECT_HUB] = {VENDOR_MICROSOFT, 0x02c2, 0x0100, CLASS_HUB, "Hub"},
            [CAMERA] = {VENDOR_MICROSOFT, 0x02ae, 0x020b, 0, "Xbox NUI Camera"},
            [AUDIO] = {VENDOR_MICROSOFT, 0x02ad, 0x0100, 0, "Xbox NUI Audio"},
        },
        [MODEL_K4W] = {
            [KINECT_HUB] = {VENDOR_MICROSOFT, 0x02c2, 0x0100, CLASS_HUB, "Hub"},
            [CAMERA] = {VENDOR_MICROSOFT, 0x02bf, 0x0210, 0, "Kinect for Windows Camera"},
            [AUDIO] = {VENDOR_MICROSOFT, 0x02be, 0x0100, 0, "Kinect for Windows Audio"},
        },
    };
    if (device->function == ROOT_HUB)
        return &root_hub;
    return &products[device->kinect->control->model][device->function];
}

void fill_device_descriptor(const struct libusb_device *device,
                            struct libusb_device_descriptor *out)
{
    const struct product *product = product_of(device);
    bool has_serial = device->function == CAMERA || device->function == AUDIO;
    *out = (struct libusb_device_descriptor){
        .bLength = 18,
        .bDescriptorType = LIBUSB_DT_DEVICE,
        .bcdUSB = 0x0200,
        .bDeviceClass = product->class,
        .bMaxPacketSize0 = 64,
        .idVendor = product->vendor,
        .idProduct = product->product,
        .bcdDevice = product->release,
        .iManufacturer = STRING_MANUFACTURER,
        .iProduct = STRING_PRODUCT,
        .iSerialNumber = has_serial ? STRING_SERIAL : 0,
        .bNumConfigurations = 1,
    };
}

/* NULL if there is no such string. */
const char *string_of(const struct libusb_device *device, uint8_t index)
{
    const volatile struct control *control = device->kinect ? device->kinect->control : NULL;
    if (index == STRING_MANUFACTURER)
        return product_of(device)->vendor == VENDOR_MICROSOFT ? "Microsoft" : "";
    if (index == STRING_PRODUCT)
        return product_of(device)->name;
    if (index == STRING_SERIAL && device->function == CAMERA)
        return (const char *)control->camera_serial;
    if (index == STRING_SERIAL && device->function == AUDIO)
        return (const char *)control->audio_serial;
    return NULL;
}

/* A configuration and its interfaces, in one allocation. */
struct configuration {
    struct libusb_config_descriptor config;
    struct libusb_interface interfaces[2];
    struct libusb_interface_descriptor alternates[2][2];
    struct libusb_endpoint_descriptor endpoints[2];
};

static struct libusb_endpoint_descriptor endpoint(int address, int type, int packet_bytes)
{
    return (struct libusb_endpoint_descriptor){
        .bLength = 7,
        .bDescriptorType = LIBUSB_DT_ENDPOINT,
        .bEndpointAddress = (uint8_t)address,
        .bmAttributes = (uint8_t)type,
        .wMaxPacketSize = (uint16_t)packet_bytes,
        .bInterval = 1,
    };
}

static void add_alternate(struct configuration *all, int interface, int class, int endpoint_count)
{
    struct libusb_interface *owner = &all->interfaces[interface];
    int alternate = owner->num_altsetting++;
    all->alternates[interface][alternate] = (struct libusb_interface_descriptor){
        .bLength = 9,
        .bDescriptorType = LIBUSB_DT_INTERFACE,
        .bInterfaceNumber = (uint8_t)interface,
        .bAlternateSetting = (uint8_t)alternate,
        .bNumEndpoints = (uint8_t)endpoint_count,
        .bInterfaceClass = (uint8_t)class,
        .endpoint = all->endpoints,
    };
    owner->altsetting = all->alternates[interface];
    all->config.bNumInterfaces = (uint8_t)(interface + 1);
}

static void describe_camera(struct configuration *all, bool k4w)
{
    /* High bandwidth: bits 11 and 12 count a second packet in the microframe. */
    enum { TWO = 1 << 11, VIDEO_BYTES = 960, DEPTH_BYTES = 880 };
    all->endpoints[0] = endpoint(0x81, TYPE_ISOCHRONOUS, TWO | VIDEO_BYTES);
    all->endpoints[1] = endpoint(0x82, TYPE_ISOCHRONOUS, TWO | (k4w ? VIDEO_BYTES : DEPTH_BYTES));
    if (k4w)
        add_alternate(all, 0, CLASS_VENDOR, 0); /* nothing reserved until alternate 1 is chosen */
    add_alternate(all, 0, CLASS_VENDOR, 2);
}

static void describe_audio(struct configuration *all, bool firmware)
{
    all->endpoints[0] = endpoint(0x01, TYPE_BULK, 512);
    all->endpoints[1] = endpoint(0x81, TYPE_BULK, 512);
    add_alternate(all, 0, CLASS_VENDOR, 2);
    if (firmware)
        add_alternate(all, 1, CLASS_VENDOR, 0);
}

int libusb_get_config_descriptor(libusb_device *device, uint8_t index,
                                 struct libusb_config_descriptor **out)
{
    struct configuration *all = index == 0 ? calloc(1, sizeof *all) : NULL;
    if (!all)
        return index == 0 ? LIBUSB_ERROR_NO_MEM : LIBUSB_ERROR_NOT_FOUND;
    all->config = (struct libusb_config_descriptor){
        .bLength = 9,
        .bDescriptorType = LIBUSB_DT_CONFIG,
        .wTotalLength = 32,
        .bConfigurationValue = 1,
        .bmAttributes = 0xc0, /* self-powered */
        .interface = all->interfaces,
    };
    if (device->function == CAMERA)
        describe_camera(all, device->kinect->control->model == MODEL_K4W);
    else if (device->function == AUDIO)
        describe_audio(all, device->kinect->control->firmware);
    else
        add_alternate(all, 0, device->function == MOTOR ? CLASS_VENDOR : CLASS_HUB, 0);
    *out = &all->config;
    return LIBUSB_SUCCESS;
}

int libusb_get_active_config_descriptor(libusb_device *device,
                                        struct libusb_config_descriptor **out)
{
    return libusb_get_config_descriptor(device, 0, out);
}

void libusb_free_config_descriptor(struct libusb_config_descriptor *config)
{
    free((struct configuration *)config); /* its first member */
}

static int packet_field(libusb_device *device, unsigned char address)
{
    struct libusb_config_descriptor *config;
    int found = LIBUSB_ERROR_NOT_FOUND;
    if (libusb_get_config_descriptor(device, 0, &config) != LIBUSB_SUCCESS)
        return LIBUSB_ERROR_NO_MEM;
    const struct configuration *all = (const struct configuration *)config; /* its first member */
    for (int i = 0; i < 2; i++)
        if (all->endpoints[i].bLength && all->endpoints[i].bEndpointAddress == address)
            found = all->endpoints[i].wMaxPacketSize;
    libusb_free_config_descriptor(config);
    return found;
}

int libusb_get_max_packet_size(libusb_device *device, unsigned char address)
{
    return packet_field(device, address);
}

int libusb_get_max_iso_packet_size(libusb_device *device, unsigned char address)
{
    int field = packet_field(device, address);
    return field < 0 ? field : (field & 0x7ff) * (1 + (field >> 11 & 3));
}
