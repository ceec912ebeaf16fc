/* Isochronous transfers: the bus slots of each, and how it ends.
 *
 * A stream's transfers occupy its slots one after the other, in the order of submission. If no
 * transfer is submitted when packets arrive, they are lost: with libfreenect's 16 transfers of 16
 * packets that is after 32 ms, as on a real bus.
 */
#include <stdlib.h>
#include <string.h>

#include "simulator.h"

static struct transfer *own_part(struct libusb_transfer *public)
{
    return (struct transfer *)((char *)public - offsetof(struct transfer, public));
}

static uint64_t ends_ns(const struct transfer *transfer)
{
    return (transfer->first_slot + (uint64_t)transfer->public.num_iso_packets) * MICROFRAME_NS;
}

static int stream_of(unsigned char endpoint)
{
    return endpoint == 0x82 ? DEPTH : endpoint == 0x81 ? VIDEO : -1;
}

struct libusb_transfer *libusb_alloc_transfer(int iso_packets)
{
    size_t packets = (size_t)iso_packets * sizeof(struct libusb_iso_packet_descriptor);
    struct transfer *transfer = calloc(1, sizeof *transfer + packets);
    if (!transfer)
        return NULL;
    transfer->public.num_iso_packets = iso_packets;
    return &transfer->public;
}

void libusb_free_transfer(struct libusb_transfer *public)
{
    if (public)
        free(own_part(public));
}

static int refusal_of(const struct libusb_transfer *public, const struct transfer *transfer)
{
    const struct libusb_device_handle *handle = public->dev_handle;
    const volatile struct control *control = handle->device->kinect->control;
    bool reserved = control->model != MODEL_K4W || handle->alternate == 1;
    if (is_gone(handle))
        return LIBUSB_ERROR_NO_DEVICE;
    if (public->type != LIBUSB_TRANSFER_TYPE_ISOCHRONOUS || handle->device->function != CAMERA ||
        stream_of(public->endpoint) < 0)
        return LIBUSB_ERROR_NOT_SUPPORTED;
    if (control->starved || control->slow_bus || !reserved)
        return LIBUSB_ERROR_IO; /* what Linux reports for the kernel's "no space" */
    return transfer->submitted ? LIBUSB_ERROR_BUSY : LIBUSB_SUCCESS;
}

/* First slot of a transfer: right behind the submitted ones, unless their time has passed. Then it
 * begins at a multiple of its own length, so that both streams' transfers end together and wake the
 * program once, not twice. */
static uint64_t next_slot(const struct libusb_device_handle *handle, int stream, unsigned packets)
{
    uint64_t soonest = now_ns() / MICROFRAME_NS + 1, after_last = handle->next_slot[stream];
    bool in_time = after_last >= soonest || handle->device->kinect->control->waits_for_reader;
    if (handle->queues[stream] && in_time)
        return after_last;
    return (soonest + packets - 1) / packets * packets;
}

int libusb_submit_transfer(struct libusb_transfer *public)
{
    struct transfer *transfer = own_part(public);
    struct libusb_device_handle *handle = public->dev_handle;
    int refusal = refusal_of(public, transfer), stream = stream_of(public->endpoint);
    if (refusal)
        return refusal;
    unsigned packets = (unsigned)public->num_iso_packets;
    pthread_mutex_lock(&bus_mutex);
    struct transfer **link = &handle->queues[stream];
    transfer->first_slot = next_slot(handle, stream, packets);
    handle->next_slot[stream] = transfer->first_slot + packets;
    while (*link)
        link = &(*link)->next;
    *link = transfer;
    transfer->next = NULL;
    transfer->submitted = true;
    transfer->cancelled = false;
    handle->device->kinect->control->streams[stream].submitted_transfers++;
    wake_waiting();
    pthread_mutex_unlock(&bus_mutex);
    return LIBUSB_SUCCESS;
}

int libusb_cancel_transfer(struct libusb_transfer *public)
{
    struct transfer *transfer = own_part(public);
    pthread_mutex_lock(&bus_mutex);
    int result = transfer->submitted ? LIBUSB_SUCCESS : LIBUSB_ERROR_NOT_FOUND;
    transfer->cancelled = transfer->submitted;
    if (transfer->submitted)
        wake_waiting();
    pthread_mutex_unlock(&bus_mutex);
    return result;
}

static void take_off(struct libusb_device_handle *handle, int stream, struct transfer **link)
{
    struct transfer *transfer = *link;
    *link = transfer->next;
    transfer->submitted = false;
    handle->device->kinect->control->streams[stream].submitted_transfers--;
}

/* Drop the transfers of a device that is closed. The real library drops them too, but the driver
 * has not stopped its streams, so the control file counts them. */
void drop_transfers(struct libusb_device_handle *handle)
{
    volatile struct control *control = handle->device->kinect->control;
    pthread_mutex_lock(&bus_mutex);
    for (int stream = 0; stream < STREAMS; stream++)
        while (handle->queues[stream]) {
            take_off(handle, stream, &handle->queues[stream]);
            control->abandoned_transfers++;
        }
    pthread_mutex_unlock(&bus_mutex);
}

static void fill(struct transfer *transfer, int stream)
{
    struct libusb_transfer *public = &transfer->public;
    struct kinect *kinect = public->dev_handle->device->kinect;
    uint8_t *packet = public->buffer;
    for (int i = 0; i < public->num_iso_packets; i++) {
        struct libusb_iso_packet_descriptor *descriptor = &public->iso_packet_desc[i];
        descriptor->actual_length = packet_in_slot(
            kinect, stream, transfer->first_slot + (uint64_t)i, packet, descriptor->length);
        descriptor->status = LIBUSB_TRANSFER_COMPLETED;
        packet += descriptor->length;
    }
}

static bool has_ended(const struct transfer *transfer, uint64_t now, bool gone)
{
    return gone || transfer->cancelled || ends_ns(transfer) <= now;
}

/* Take the next ended transfer of this device from its queue, with its status set; NULL if there is
 * none. Hold the mutex. */
struct transfer *take_ended(struct libusb_device_handle *handle, uint64_t now)
{
    bool gone = is_gone(handle);
    for (int stream = 0; stream < STREAMS; stream++)
        for (struct transfer **link = &handle->queues[stream]; *link; link = &(*link)->next) {
            struct transfer *transfer = *link;
            if (!has_ended(transfer, now, gone))
                continue;
            take_off(handle, stream, link);
            transfer->public.status = gone                  ? LIBUSB_TRANSFER_NO_DEVICE
                                      : transfer->cancelled ? LIBUSB_TRANSFER_CANCELLED
                                                            : LIBUSB_TRANSFER_COMPLETED;
            if (transfer->public.status == LIBUSB_TRANSFER_COMPLETED)
                fill(transfer, stream);
            return transfer;
        }
    return NULL;
}

/* When the first submitted transfer ends, or the deadline if that is sooner. Hold the mutex. */
uint64_t soonest_end(const struct libusb_context *context, uint64_t deadline_ns)
{
    for (struct libusb_device_handle *handle = context->handles; handle; handle = handle->next)
        for (int stream = 0; stream < STREAMS; stream++)
            if (handle->queues[stream] && ends_ns(handle->queues[stream]) < deadline_ns)
                deadline_ns = ends_ns(handle->queues[stream]);
    return deadline_ns;
}
