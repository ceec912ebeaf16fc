/* The audio device: on the 1473 and the K4W it also controls tilt, LED and accelerometer.
 *
 * Commands and replies are messages of 32-bit words on a pair of bulk endpoints. After power on the
 * device only accepts its firmware, which the host must upload.
 */
#include <string.h>

#include "simulator.h"

#define COMMAND_MAGIC 0x06022009u
#define ANSWER_MAGIC 0x0a6fe000u

enum { WRITE_PAGE = 0x03, LAUNCH = 0x04 }; /* accepted before the firmware is loaded */
enum { SET_LED = 0x10, READ_STATE = 0x8032, SET_TILT = 0x803b };
enum { ANSWER_BYTES = 12, STATE_BYTES = 104, STATE_AT = 16, COMMAND_BYTES = 16 };

static uint8_t *new_answer(struct libusb_device_handle *handle, int length)
{
    if (handle->audio_reply_count == AUDIO_REPLIES)
        handle->audio_reply_count = 0; /* nothing reads them: restart */
    struct reply *reply = &handle->audio_replies[handle->audio_reply_count++];
    memset(reply, 0, sizeof *reply);
    reply->length = length;
    return reply->bytes;
}

static void answer_done(struct libusb_device_handle *handle, uint32_t tag)
{
    uint8_t *answer = new_answer(handle, ANSWER_BYTES);
    put32(answer, ANSWER_MAGIC);
    put32(answer + 4, tag);
}

static void answer_state(struct libusb_device_handle *handle)
{
    const volatile struct control *control = handle->device->kinect->control;
    uint8_t *state = new_answer(handle, STATE_BYTES) + STATE_AT;
    bool moving;
    for (int axis = 0; axis < 3; axis++)
        put32(state + 4 * axis, (uint32_t)control->acceleration[axis]);
    put32(state + 12, (uint32_t)tilt_now_deg(control, &moving));
}

/* The LED's numbers differ from the 1414's, which the control file has. */
static uint32_t led_of_1414(uint32_t led)
{
    static const uint32_t known[] = {[1] = 0, [2] = 4, [3] = 1, [4] = 2};
    return led < sizeof known / sizeof *known ? known[led] : 0;
}

static void obey_firmware(struct libusb_device_handle *handle, uint32_t command, uint32_t argument)
{
    volatile struct control *control = handle->device->kinect->control;
    if (command == SET_LED)
        control->led = led_of_1414(argument);
    else if (command == SET_TILT)
        set_tilt(control, (int32_t)argument);
    else if (command == READ_STATE)
        answer_state(handle);
}

/* Other commands are ignored: the host's read times out. */
static void obey_bootloader(struct libusb_device_handle *handle, uint32_t command, uint32_t bytes,
                            uint32_t tag)
{
    if (command == WRITE_PAGE)
        handle->firmware_bytes_due = (int)bytes;
    else if (command == LAUNCH) {
        handle->device->kinect->control->firmware = 1;
        answer_done(handle, tag);
    }
    handle->firmware_tag = tag;
}

static void take_firmware(struct libusb_device_handle *handle, int length)
{
    handle->firmware_bytes_due -= length;
    if (handle->firmware_bytes_due <= 0)
        answer_done(handle, handle->firmware_tag);
}

void audio_command(struct libusb_device_handle *handle, const uint8_t *data, int length)
{
    uint8_t words[COMMAND_BYTES + 4] = {0};
    if (handle->firmware_bytes_due > 0) {
        take_firmware(handle, length);
        return;
    }
    memcpy(words, data, (size_t)(length < (int)sizeof words ? length : (int)sizeof words));
    uint32_t tag = get32(words + 4), bytes = get32(words + 8), command = get32(words + 12);
    if (get32(words) != COMMAND_MAGIC)
        return;
    if (!handle->device->kinect->control->firmware) {
        obey_bootloader(handle, command, bytes, tag);
        return;
    }
    obey_firmware(handle, command, get32(words + 16));
    answer_done(handle, tag);
}

/* Bytes of the oldest unread reply, 0 if there is none. */
int audio_answer(struct libusb_device_handle *handle, uint8_t *data, int room)
{
    struct reply *first = handle->audio_replies;
    if (handle->audio_reply_count == 0)
        return 0;
    int bytes = first->length < room ? first->length : room;
    memcpy(data, first->bytes, (size_t)bytes);
    handle->audio_reply_count--;
    memmove(first, first + 1, (size_t)handle->audio_reply_count * sizeof *first);
    return bytes;
}
