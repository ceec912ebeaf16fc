/* The control file: commands from Python to the simulated Kinect, and its state.
 *
 * Every process that uses the Kinect maps the file, so it also holds the state of a real Kinect's
 * hardware: registers, tilt, LED. `kinect_control.py` has the same fields in the same order; `size`
 * lets each side check the other.
 */
#ifndef CONTROL_H
#define CONTROL_H

#include <stdint.h>

#define CONTROL_MAGIC 0x4B494E31u /* "KIN1" */

enum stream { DEPTH, VIDEO, STREAMS };
enum loop { ONCE, AROUND, THERE_AND_BACK };
enum model { MODEL_1414, MODEL_1473, MODEL_K4W };
enum { CAMERA_REGISTERS = 0x400, CMOS_REGISTERS = 0x400 };
enum { SERIAL_ROOM = 32, PATH_ROOM = 1024 };

/* Locks of bytes beyond the end of the file: open handles and claimed interfaces. Like the
 * kernel's own, they end with their process, however it ends. */
enum { LOCKS_OPEN_HANDLES = 1 << 20, OPEN_HANDLE_SLOTS = 64, LOCKS_CLAIMS = 1 << 21 };

struct stream_control {
    /* Commands. */
    uint32_t stalled;     /* slots stay empty */
    uint32_t lose_every;  /* every n-th packet is lost; 0 = none */
    uint32_t lose_next;   /* number of packets to lose from now on; counts down */
    int32_t offset_ns;    /* how much later this stream's frames begin */
    /* Read-outs. */
    uint64_t frames_sent;
    uint64_t packets_lost;
    /* Frames that begin before this time are not sent: the stream was off. */
    uint64_t sends_from_ns;
    uint32_t submitted_transfers;
    uint32_t unused;
};

struct control {
    uint32_t magic, size;

    /* Identity. */
    uint32_t model;
    char camera_serial[SERIAL_ROOM], audio_serial[SERIAL_ROOM], recording[PATH_ROOM];
    int32_t registration[29]; /* polynomial of the depth-to-color map, as the camera stores it */
    uint16_t padding[3];      /* start, end and cropping lines */
    uint16_t const_shift;
    float zero_plane[4]; /* emitter, color camera, reference plane, pixel on it; cm */

    /* Faults and settings. */
    uint32_t plugged;
    uint32_t generation; /* number of times plugged in: older handles are dead */
    uint32_t frozen;     /* control replies have no bytes */
    uint32_t busy;       /* the camera cannot be claimed */
    uint32_t forbidden;  /* nothing can be opened */
    uint32_t starved;    /* no bandwidth: transfers cannot be submitted */
    uint32_t slow_bus;   /* full speed instead of high speed */
    uint32_t firmware;   /* the audio device has its firmware (1473, K4W) */
    uint32_t kernel_driver; /* gspca_kinect holds the camera */
    uint32_t rate;          /* frames per second */
    uint32_t loop;          /* what follows the last frame: enum loop */
    uint32_t start_ticks;   /* the 60 MHz clock at the first frame after power on */
    uint32_t tilt_deg_per_s;

    /* State of the hardware. */
    int32_t acceleration[3]; /* counts, 819 per g, in the order and signs of the wire */
    int32_t tilt_from_deg, tilt_to_deg;
    uint32_t led; /* in the 1414's numbers */
    uint64_t tilt_start_ns;
    uint64_t playback_start_ns; /* CLOCK_MONOTONIC of frame 0; 0 = not yet */
    int64_t clock_start_frame;  /* the frame with the stamp start_ticks; -1 = not yet */
    uint32_t abandoned_transfers; /* still submitted when their device was closed */
    uint32_t waits_for_reader;    /* a setting: the bus waits for a late program */
    struct stream_control streams[STREAMS];
    uint16_t registers[CAMERA_REGISTERS];
    uint16_t cmos[CMOS_REGISTERS];
};

#endif
