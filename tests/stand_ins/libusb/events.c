/* Isochronous transfers, and the waiting for them.
 *
 * A stream's transfers take up its slots one after the other, in the order in which they were
 * submitted. A program that is late has none waiting when packets come, and loses those: with
 * libfreenect's 16 transfers of 16 packets that is after 32 ms, as with the real bus.
 */
#define _GNU_SOURCE
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "played.h"

enum { LONGEST_WAIT_S = 60 };

static pthread_cond_t something_changed;
static pthread_once_t condition_made = PTHREAD_ONCE_INIT;
static _Thread_local bool calling_back;

static void make_condition(void)
{
    pthread_condattr_t attributes;
    pthread_condattr_init(&attributes);
    pthread_condattr_setclock(&attributes, CLOCK_MONOTONIC);
    pthread_cond_init(&something_changed, &attributes);
}

bool in_a_callback(void) { return calling_back; }

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
        return LIBUSB_ERROR_NOT_SUPPORTED;
    return transfer->submitted ? LIBUSB_ERROR_BUSY : LIBUSB_SUCCESS;
}

/* A transfer that finds no other waiting begins at a multiple of its own length, so that both
 * streams' transfers end together and wake the program once, not twice. */
static uint64_t next_slot(const struct transfer *waiting, uint64_t after_last, unsigned packets)
{
    uint64_t soonest = now_ns() / MICROFRAME_NS + 1;
    if (waiting && after_last >= soonest)
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
    pthread_once(&condition_made, make_condition);
    pthread_mutex_lock(&bus_mutex);
    struct transfer **link = &handle->queues[stream];
    transfer->first_slot = next_slot(*link, handle->next_slot[stream], packets);
    handle->next_slot[stream] = transfer->first_slot + packets;
    while (*link)
        link = &(*link)->next;
    *link = transfer;
    transfer->next = NULL;
    transfer->submitted = true;
    transfer->cancelled = false;
    handle->device->kinect->control->streams[stream].submitted_transfers++;
    pthread_cond_broadcast(&something_changed);
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
        pthread_cond_broadcast(&something_changed);
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

/* The device is closed with transfers under way. The real library forgets them too; but a driver
 * that does this has not stopped its streams, and the control file says so. */
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

/* The next transfer of this device that has ended, off its queue and with its status set. */
static struct transfer *take_ended(struct libusb_device_handle *handle, uint64_t now)
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

static struct transfer *take_any_ended(struct libusb_context *context, uint64_t now)
{
    struct transfer *transfer = NULL;
    for (struct libusb_device_handle *handle = context->handles; handle && !transfer;
         handle = handle->next)
        transfer = take_ended(handle, now);
    return transfer;
}

static bool call_back_ended(struct libusb_context *context)
{
    uint64_t now = now_ns();
    bool any = false;
    for (;;) {
        pthread_mutex_lock(&bus_mutex);
        struct transfer *transfer = take_any_ended(context, now);
        pthread_mutex_unlock(&bus_mutex);
        if (!transfer)
            return any;
        any = true;
        calling_back = true;
        transfer->public.callback(&transfer->public);
        calling_back = false;
    }
}

static uint64_t soonest_end(const struct libusb_context *context, uint64_t deadline_ns)
{
    for (struct libusb_device_handle *handle = context->handles; handle; handle = handle->next)
        for (int stream = 0; stream < STREAMS; stream++)
            if (handle->queues[stream] && ends_ns(handle->queues[stream]) < deadline_ns)
                deadline_ns = ends_ns(handle->queues[stream]);
    return deadline_ns;
}

static void wait_until(struct libusb_context *context, uint64_t deadline_ns)
{
    pthread_mutex_lock(&bus_mutex);
    uint64_t until = soonest_end(context, deadline_ns);
    struct timespec at = {(time_t)(until / 1000000000u), (long)(until % 1000000000u)};
    pthread_cond_timedwait(&something_changed, &bus_mutex, &at);
    pthread_mutex_unlock(&bus_mutex);
}

/* Returns once something has ended and been told, or at the deadline. */
void handle_events_until(struct libusb_context *context, uint64_t deadline_ns)
{
    pthread_once(&condition_made, make_condition);
    while (!call_back_ended(context) && now_ns() < deadline_ns)
        wait_until(context, deadline_ns);
}

/* A blocking transfer: as in the real library, callbacks run on the thread that waits for it. */
void spend_time_on_the_bus(struct libusb_context *context, uint64_t duration_ns)
{
    uint64_t deadline_ns = now_ns() + duration_ns;
    while (now_ns() < deadline_ns)
        handle_events_until(context, deadline_ns);
}

int libusb_handle_events_timeout_completed(libusb_context *context, struct timeval *timeout,
                                           int *completed)
{
    uint64_t wait_ns = (uint64_t)timeout->tv_sec * 1000000000u + (uint64_t)timeout->tv_usec * 1000u;
    if (calling_back)
        return LIBUSB_ERROR_BUSY;
    if (!completed || !*completed)
        handle_events_until(context_or_default(context), now_ns() + wait_ns);
    return LIBUSB_SUCCESS;
}

int libusb_handle_events_timeout(libusb_context *context, struct timeval *timeout)
{
    return libusb_handle_events_timeout_completed(context, timeout, NULL);
}

int libusb_handle_events_completed(libusb_context *context, int *completed)
{
    struct timeval timeout = {LONGEST_WAIT_S, 0};
    return libusb_handle_events_timeout_completed(context, &timeout, completed);
}

int libusb_handle_events(libusb_context *context)
{
    return libusb_handle_events_completed(context, NULL);
}
