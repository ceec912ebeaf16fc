/* The motor device of the 1414: tilt, LED and accelerometer, by control transfers. */
#include <stdlib.h>
#include <string.h>

#include "simulator.h"

enum { SET_LED = 0x06, READY = 0x10, SET_TILT = 0x31, STATE = 0x32 };
enum { READY_YES = 0x22, STATE_BYTES = 10 };
enum { STATUS_STOPPED = 0, STATUS_LIMIT = 1, STATUS_MOVING = 4 };
enum { MOST_TILT_DEG = 31, ANGLE_UNKNOWN = -128 };

/* The angle of the head while it moves to its target. */
int tilt_now_deg(const volatile struct control *control, bool *moving)
{
    int whole = control->tilt_to_deg - control->tilt_from_deg;
    uint64_t elapsed_us = (now_ns() - control->tilt_start_ns) / 1000u;
    uint64_t travelled = elapsed_us * control->tilt_deg_per_s / 1000000u;
    *moving = travelled < (uint64_t)abs(whole);
    if (!*moving)
        return control->tilt_to_deg;
    return control->tilt_from_deg + (whole > 0 ? (int)travelled : -(int)travelled);
}

void set_tilt(volatile struct control *control, int degrees)
{
    bool moving;
    int from = tilt_now_deg(control, &moving);
    if (degrees > MOST_TILT_DEG)
        degrees = MOST_TILT_DEG;
    if (degrees < -MOST_TILT_DEG)
        degrees = -MOST_TILT_DEG;
    control->tilt_from_deg = from;
    control->tilt_to_deg = degrees;
    control->tilt_start_ns = now_ns();
}

int motor_request(struct kinect *kinect, uint8_t request, uint16_t value)
{
    if (request == SET_LED)
        kinect->control->led = value;
    else if (request == SET_TILT)
        set_tilt(kinect->control, (int16_t)value / 2); /* the wire counts half degrees */
    else
        return LIBUSB_ERROR_PIPE;
    return 0;
}

static void put_be16(uint8_t *at, int value)
{
    at[0] = (uint8_t)((unsigned)value >> 8);
    at[1] = (uint8_t)value;
}

static void write_state(const volatile struct control *control, uint8_t *state)
{
    bool moving;
    int degrees = tilt_now_deg(control, &moving);
    bool limit = abs(degrees) == MOST_TILT_DEG;
    for (int axis = 0; axis < 3; axis++)
        put_be16(state + 2 + 2 * axis, control->acceleration[axis]);
    state[8] = (uint8_t)(int8_t)(moving ? ANGLE_UNKNOWN : 2 * degrees);
    state[9] = moving ? STATUS_MOVING : limit ? STATUS_LIMIT : STATUS_STOPPED;
}

int motor_answer(struct kinect *kinect, uint8_t request, uint8_t *data, int room)
{
    uint8_t state[STATE_BYTES] = {0};
    int bytes = request == READY ? 1 : STATE_BYTES;
    if (request != READY && request != STATE)
        return LIBUSB_ERROR_PIPE;
    if (request == READY)
        state[0] = READY_YES;
    else
        write_state(kinect->control, state);
    bytes = bytes < room ? bytes : room;
    memcpy(data, state, (size_t)bytes);
    return bytes;
}
