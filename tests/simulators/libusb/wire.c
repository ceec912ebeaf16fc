/* The packets on the wire, by time.
 *
 * Playback runs on the host's monotonic clock: frame k begins at playback_start + k / rate, whether
 * or not a program streams. A frame's packets follow each other in slots of 125 microseconds; the
 * remaining slots of its period are empty.
 */
#include <string.h>
#include <sys/mman.h>

#include "simulator.h"

enum { HEADER_BYTES = 12 };
enum { FIRST = 1, MIDDLE = 2, LAST = 5 }; /* in the low half of the flag */
enum { REGISTER_VIDEO = 0x05, REGISTER_DEPTH = 0x06 };
enum { TICKS_PER_S = 60000000 };
enum { PAGE_BYTES = 4096 };
#define NS_PER_S 1000000000
#define START_DELAY_NS 100000000 /* from the command to stream until the first frame */

/* One stream's part of a frame of the recording. */
struct picture {
    const uint8_t *bytes;
    unsigned length, packet_bytes;
    uint8_t flag;
};

static int64_t frame_begins_ns(const volatile struct control *control, enum stream stream,
                               int64_t frame)
{
    return (int64_t)control->playback_start_ns + control->streams[stream].offset_ns +
           frame * NS_PER_S / control->rate;
}

static int64_t frame_at(const volatile struct control *control, enum stream stream, uint64_t ns)
{
    int64_t since = (int64_t)ns - frame_begins_ns(control, stream, 0);
    return since < 0 ? -1 : since * control->rate / NS_PER_S;
}

/* The first stream starts playback. If the second stream is switched on before frame 0 begins,
 * frame 0 is delayed, so that both streams have it. */
void stream_switched_on(struct kinect *kinect, enum stream stream)
{
    volatile struct control *control = kinect->control;
    uint64_t now = now_ns(), begins = now + START_DELAY_NS;
    bool fresh = control->playback_start_ns == 0 || control->playback_start_ns > now;
    if (fresh)
        control->playback_start_ns = begins;
    control->streams[stream].sends_from_ns = fresh ? now : begins;
    if (control->clock_start_frame < 0)
        control->clock_start_frame = fresh ? 0 : frame_at(control, stream, begins) + 1;
}

static uint32_t stamp_of(const volatile struct control *control, enum stream stream, int64_t frame)
{
    int64_t whole = (frame - control->clock_start_frame) * (TICKS_PER_S / control->rate);
    int64_t offset = (int64_t)control->streams[stream].offset_ns * (TICKS_PER_S / 1000000) / 1000;
    return control->start_ticks + (uint32_t)(whole + offset);
}

/* Index in the recording of a frame of the playback; -1 for none. */
static int64_t recorded_frame(const struct kinect *kinect, int64_t frame)
{
    int64_t count = kinect->recording.count, phase = frame % (2 * count);
    switch (kinect->control->loop) {
    case ONCE:
        return frame < count ? frame : -1;
    case THERE_AND_BACK:
        return phase < count ? phase : 2 * count - 1 - phase;
    default:
        return frame % count;
    }
}

static size_t frame_bytes(const struct recording *recording)
{
    return (size_t)recording->depth_bytes + recording->video_bytes;
}

static struct picture picture_of(const struct kinect *kinect, enum stream stream, int64_t frame)
{
    const struct recording *recording = &kinect->recording;
    const uint8_t *start =
        recording->frames + (size_t)recorded_frame(kinect, frame) * frame_bytes(recording);
    if (stream == DEPTH)
        return (struct picture){start, recording->depth_bytes, 1748, 0x70};
    return (struct picture){start + recording->depth_bytes, recording->video_bytes, 1908, 0x80};
}

static bool is_sent(const struct kinect *kinect, enum stream stream, int64_t frame)
{
    const volatile struct control *control = kinect->control;
    const volatile struct stream_control *own = &control->streams[stream];
    uint16_t on = control->registers[stream == DEPTH ? REGISTER_DEPTH : REGISTER_VIDEO];
    if (!on || own->stalled || control->playback_start_ns == 0 || frame < 0 ||
        recorded_frame(kinect, frame) < 0)
        return false;
    return frame_begins_ns(control, stream, frame) >= (int64_t)own->sends_from_ns;
}

static bool is_lost(volatile struct stream_control *own, int64_t packet)
{
    bool in_burst = own->lose_next > 0;
    bool lost = in_burst || (own->lose_every && packet % own->lose_every == 0);
    if (in_burst)
        __atomic_sub_fetch(&own->lose_next, 1, __ATOMIC_SEQ_CST);
    if (lost)
        own->packets_lost++;
    return lost;
}

static void write_header(uint8_t *packet, uint8_t flag, uint8_t sequence, uint32_t stamp)
{
    memset(packet, 0, HEADER_BYTES);
    packet[0] = 'R';
    packet[1] = 'B';
    packet[3] = flag;
    packet[5] = sequence;
    put32(packet + 8, stamp);
}

/* Give the pages of the recording back, so that they are not counted as the program's memory. They
 * are read again from the file's cache. */
static void forget(const struct recording *recording)
{
    uintptr_t begin = (uintptr_t)recording->frames & ~(uintptr_t)(PAGE_BYTES - 1);
    madvise((void *)begin, recording->count * frame_bytes(recording), MADV_DONTNEED);
}

/* Number of bytes written to `packet`; 0 for an empty slot. */
unsigned packet_in_slot(struct kinect *kinect, enum stream stream, uint64_t slot, uint8_t *packet,
                        unsigned room)
{
    volatile struct control *control = kinect->control;
    uint64_t slot_ns = slot * MICROFRAME_NS;
    int64_t frame = frame_at(control, stream, slot_ns);
    if (!is_sent(kinect, stream, frame))
        return 0;
    struct picture picture = picture_of(kinect, stream, frame);
    unsigned packets = (picture.length + picture.packet_bytes - 1) / picture.packet_bytes;
    unsigned number = (unsigned)(((int64_t)slot_ns - frame_begins_ns(control, stream, frame)) /
                                 MICROFRAME_NS);
    if (number >= packets)
        return 0;
    int64_t counted = frame * packets + number;
    if (number + 1 == packets)
        control->streams[stream].frames_sent++;
    if (is_lost(&control->streams[stream], counted))
        return 0;
    unsigned start = number * picture.packet_bytes, bytes = picture.length - start;
    if (bytes > picture.packet_bytes)
        bytes = picture.packet_bytes;
    if (bytes + HEADER_BYTES > room)
        return 0;
    uint8_t place = number == 0 ? FIRST : number + 1 == packets ? LAST : MIDDLE;
    write_header(packet, picture.flag | place, (uint8_t)counted,
                 stamp_of(control, stream, frame));
    memcpy(packet + HEADER_BYTES, picture.bytes + start, bytes);
    if (place == LAST)
        forget(&kinect->recording);
    return HEADER_BYTES + bytes;
}
