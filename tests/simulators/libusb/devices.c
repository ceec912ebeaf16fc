/* The bus: its devices and their tree. */
#include <stdlib.h>

#include "simulator.h"

/* A root hub and the four devices of a Kinect. */
enum { MOST_DEVICES = MAX_KINECTS * 5 + 1 };
enum { FIRST_ADDRESS = 4, ADDRESSES_A_PLUGGING = 4, ADDRESSES = 120 };

static struct libusb_device *known_devices;

/* The device of this function: the same object as long as it is referenced. */
static struct libusb_device *device_of(struct libusb_context *context, struct kinect *kinect,
                                       enum function function, struct libusb_device *parent,
                                       int bus)
{
    uint32_t generation = function == ROOT_HUB ? 0 : kinect->control->generation;
    struct libusb_device *device = known_devices;
    while (device && !(device->context == context && device->kinect == kinect &&
                       device->function == function && device->bus == bus &&
                       device->generation == generation))
        device = device->next;
    if (device) {
        device->references++;
        return device;
    }
    device = calloc(1, sizeof *device);
    if (!device)
        abort();
    uint32_t address = FIRST_ADDRESS + generation * ADDRESSES_A_PLUGGING + function;
    *device = (struct libusb_device){
        .next = known_devices,
        .parent = parent ? libusb_ref_device(parent) : NULL,
        .context = context,
        .kinect = kinect,
        .function = function,
        .generation = generation,
        .references = 1,
        .bus = (uint8_t)bus,
        .address = function == ROOT_HUB ? 1 : (uint8_t)(address % ADDRESSES + 2),
        .port = (uint8_t)function, /* the root hub has none: 0 */
    };
    return known_devices = device;
}

static int list_kinect(struct libusb_context *context, struct kinect *kinect, int bus,
                       libusb_device **list)
{
    int count = 0;
    struct libusb_device *root = device_of(context, kinect, ROOT_HUB, NULL, bus);
    list[count++] = root;
    if (!kinect || !kinect->control->plugged)
        return count;
    struct libusb_device *hub = device_of(context, kinect, KINECT_HUB, root, bus);
    list[count++] = hub;
    if (kinect->control->model == MODEL_1414)
        list[count++] = device_of(context, kinect, MOTOR, hub, bus);
    list[count++] = device_of(context, kinect, CAMERA, hub, bus);
    list[count++] = device_of(context, kinect, AUDIO, hub, bus);
    return count;
}

ssize_t libusb_get_device_list(libusb_context *context, libusb_device ***out)
{
    libusb_device **list = calloc(MOST_DEVICES + 1, sizeof *list);
    ssize_t count = 0;
    context = context_or_default(context);
    if (!list || !context) {
        free(list);
        return LIBUSB_ERROR_NO_MEM;
    }
    pthread_mutex_lock(&bus_mutex);
    look_up_kinects(context);
    for (int i = 0; i < context->kinect_count; i++)
        count += list_kinect(context, context->kinects[i], i + 1, list + count);
    if (context->kinect_count == 0)
        count = list_kinect(context, NULL, 1, list);
    pthread_mutex_unlock(&bus_mutex);
    *out = list;
    return count;
}

void libusb_free_device_list(libusb_device **list, int unref_devices)
{
    for (libusb_device **device = list; list && *device && unref_devices; device++)
        libusb_unref_device(*device);
    free(list);
}

libusb_device *libusb_ref_device(libusb_device *device)
{
    __atomic_add_fetch(&device->references, 1, __ATOMIC_SEQ_CST);
    return device;
}

static void forget(struct libusb_device *device)
{
    struct libusb_device **link = &known_devices;
    while (*link != device)
        link = &(*link)->next;
    *link = device->next;
}

void libusb_unref_device(libusb_device *device)
{
    struct libusb_device *parent = NULL;
    pthread_mutex_lock(&bus_mutex);
    if (__atomic_sub_fetch(&device->references, 1, __ATOMIC_SEQ_CST) == 0) {
        parent = device->parent;
        forget(device);
        free(device);
    }
    pthread_mutex_unlock(&bus_mutex);
    if (parent)
        libusb_unref_device(parent);
}

libusb_device *libusb_get_parent(libusb_device *device) { return device->parent; }
uint8_t libusb_get_bus_number(libusb_device *device) { return device->bus; }
uint8_t libusb_get_device_address(libusb_device *device) { return device->address; }
uint8_t libusb_get_port_number(libusb_device *device) { return device->port; }

int libusb_get_port_numbers(libusb_device *device, uint8_t *ports, int room)
{
    int depth = 0, i;
    for (struct libusb_device *at = device; at->parent; at = at->parent)
        depth++;
    if (depth > room)
        return LIBUSB_ERROR_OVERFLOW;
    for (i = depth; device->parent; device = device->parent)
        ports[--i] = device->port;
    return depth;
}

int libusb_get_device_speed(libusb_device *device)
{
    bool slow = device->kinect && device->kinect->control->slow_bus;
    return slow ? LIBUSB_SPEED_FULL : LIBUSB_SPEED_HIGH;
}

int libusb_get_device_descriptor(libusb_device *device, struct libusb_device_descriptor *out)
{
    fill_device_descriptor(device, out);
    return LIBUSB_SUCCESS;
}
