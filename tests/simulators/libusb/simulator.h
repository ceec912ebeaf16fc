/* Declarations shared by the files of the simulated libusb. */
#ifndef SIMULATOR_H
#define SIMULATOR_H

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "control.h"
#include "libusb_abi.h"

enum { MAX_KINECTS = 4 };
enum { MICROFRAME_NS = 125000 }; /* USB 2: one isochronous packet per endpoint in each */

/* The frames in USB format, from a file of usb_frames.py. */
struct recording {
    const uint8_t *frames;
    uint32_t count, depth_bytes, video_bytes;
};

struct kinect {
    struct kinect *next;
    char path[PATH_ROOM];
    volatile struct control *control;
    struct recording recording;
};

struct libusb_context {
    char paths[PATH_ROOM]; /* KINECT_SIMULATOR at the last lookup of Kinects */
    struct kinect *kinects[MAX_KINECTS];
    int kinect_count;
    struct libusb_device_handle *handles;
};

enum function { ROOT_HUB, KINECT_HUB, CAMERA, MOTOR, AUDIO };

struct libusb_device {
    struct libusb_device *next, *parent;
    struct libusb_context *context;
    struct kinect *kinect; /* NULL for the root hub of an empty bus */
    enum function function;
    uint32_t generation;
    int references;
    uint8_t bus, address, port;
};

struct transfer {
    struct transfer *next;
    uint64_t first_slot;
    bool submitted, cancelled;
    struct libusb_transfer public;
};

struct reply {
    int length;
    uint8_t bytes[400];
};

enum { AUDIO_REPLIES = 4 };

struct libusb_device_handle {
    struct libusb_device_handle *next;
    struct libusb_device *device;
    int file; /* holds the locks of this handle in the control file */
    int alternate;
    bool detached_driver;
    struct reply camera_reply;
    struct reply audio_replies[AUDIO_REPLIES];
    int audio_reply_count;
    int firmware_bytes_due;
    uint32_t firmware_tag;
    struct transfer *queues[STREAMS]; /* in the order of their slots */
    uint64_t next_slot[STREAMS];
};

/* context.c */
extern pthread_mutex_t bus_mutex; /* guards all lists */
uint64_t now_ns(void);
struct libusb_context *context_or_default(struct libusb_context *context);
void look_up_kinects(struct libusb_context *context);

/* products.c */
void fill_device_descriptor(const struct libusb_device *device,
                            struct libusb_device_descriptor *out);
const char *string_of(const struct libusb_device *device, uint8_t index);

/* handles.c */
bool is_gone(const struct libusb_device_handle *handle);

/* camera.c */
void camera_request(struct libusb_device_handle *handle, const uint8_t *data, int length);
int camera_answer(struct libusb_device_handle *handle, uint8_t *data, int room);

/* motor.c */
int motor_request(struct kinect *kinect, uint8_t request, uint16_t value);
int motor_answer(struct kinect *kinect, uint8_t request, uint8_t *data, int room);
int tilt_now_deg(const volatile struct control *control, bool *moving);
void set_tilt(volatile struct control *control, int degrees);

/* audio.c */
void audio_command(struct libusb_device_handle *handle, const uint8_t *data, int length);
int audio_answer(struct libusb_device_handle *handle, uint8_t *data, int room);

/* wire.c */
void stream_switched_on(struct kinect *kinect, enum stream stream);
unsigned packet_in_slot(struct kinect *kinect, enum stream stream, uint64_t slot, uint8_t *packet,
                        unsigned room);

/* transfers.c */
struct transfer *take_ended(struct libusb_device_handle *handle, uint64_t now);
uint64_t soonest_end(const struct libusb_context *context, uint64_t deadline_ns);
void drop_transfers(struct libusb_device_handle *handle);

/* events.c */
void wake_waiting(void);
bool in_a_callback(void);
void handle_events_until(struct libusb_context *context, uint64_t deadline_ns);
void spend_time_on_the_bus(struct libusb_context *context, uint64_t duration_ns);

/* Little-endian numbers in a message. */
static inline uint16_t get16(const uint8_t *at) { return (uint16_t)(at[0] | at[1] << 8); }
static inline uint32_t get32(const uint8_t *at)
{
    return get16(at) | (uint32_t)get16(at + 2) << 16;
}
static inline void put16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
}
static inline void put32(uint8_t *at, uint32_t value)
{
    put16(at, (uint16_t)value);
    put16(at + 2, (uint16_t)(value >> 16));
}

#endif
