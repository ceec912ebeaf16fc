/* Wait for transfers to end, and call their callbacks. There is no event thread: the caller that
 * handles events sleeps until the next transfer ends. */
#define _GNU_SOURCE
#include <time.h>

#include "simulator.h"

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

/* Wake waiting callers after a submission or a cancellation. Hold the mutex. */
void wake_waiting(void)
{
    pthread_once(&condition_made, make_condition);
    pthread_cond_broadcast(&something_changed);
}

bool in_a_callback(void) { return calling_back; }

static struct transfer *take_any_ended(struct libusb_context *context, uint64_t now)
{
    struct transfer *transfer = NULL;
    for (struct libusb_device_handle *handle = context->handles; handle && !transfer;
         handle = handle->next)
        transfer = take_ended(handle, now);
    return transfer;
}

/* Whether any transfer had ended; those that end during the callbacks are for the next call. */
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

static void wait_until(struct libusb_context *context, uint64_t deadline_ns)
{
    pthread_mutex_lock(&bus_mutex);
    uint64_t until = soonest_end(context, deadline_ns);
    struct timespec at = {(time_t)(until / 1000000000u), (long)(until % 1000000000u)};
    pthread_cond_timedwait(&something_changed, &bus_mutex, &at);
    pthread_mutex_unlock(&bus_mutex);
}

/* Return after the callbacks of ended transfers, or at the deadline. */
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
