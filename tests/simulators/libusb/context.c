/* The library's context, and the simulated Kinects that it sees. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "simulator.h"

#define RECORDING_MAGIC 0x4D4C464Bu /* "KFLM" */
enum { RECORDING_HEADER_BYTES = 64 };

pthread_mutex_t bus_mutex = PTHREAD_MUTEX_INITIALIZER;

/* Kinects stay mapped until the process ends: open devices may still be used. */
static struct kinect *known_kinects;
static struct libusb_context *default_context;

uint64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}

struct libusb_context *context_or_default(struct libusb_context *context)
{
    return context ? context : default_context;
}

/* Map a file, shared with other processes; NULL on failure. */
static void *map_file(const char *path, int mode, size_t at_least)
{
    struct stat status;
    void *bytes = MAP_FAILED;
    int file = open(path, mode | O_CLOEXEC);
    if (file < 0)
        return NULL;
    if (fstat(file, &status) == 0 && (size_t)status.st_size >= at_least) {
        int access = mode == O_RDWR ? PROT_READ | PROT_WRITE : PROT_READ;
        bytes = mmap(NULL, (size_t)status.st_size, access, MAP_SHARED, file, 0);
    }
    close(file);
    return bytes == MAP_FAILED ? NULL : bytes;
}

static bool load_recording(struct recording *recording, const char *path)
{
    const uint8_t *bytes = map_file(path, O_RDONLY, RECORDING_HEADER_BYTES);
    if (!bytes || get32(bytes) != RECORDING_MAGIC)
        return false;
    recording->count = get32(bytes + 4);
    recording->depth_bytes = get32(bytes + 8);
    recording->video_bytes = get32(bytes + 12);
    recording->frames = bytes + RECORDING_HEADER_BYTES;
    return recording->count > 0;
}

static struct kinect *map_kinect(const char *path)
{
    struct kinect *kinect = calloc(1, sizeof *kinect);
    volatile struct control *control = map_file(path, O_RDWR, sizeof *control);
    bool same_version = control && control->magic == CONTROL_MAGIC &&
                        control->size == sizeof *control;
    if (!kinect || !same_version ||
        !load_recording(&kinect->recording, (const char *)control->recording)) {
        fprintf(stderr, "Kinect simulator: %s is not a control file of this version\n", path);
        free(kinect);
        return NULL;
    }
    snprintf(kinect->path, sizeof kinect->path, "%s", path);
    kinect->control = control;
    kinect->next = known_kinects;
    return known_kinects = kinect;
}

static struct kinect *kinect_of(const char *path)
{
    for (struct kinect *kinect = known_kinects; kinect; kinect = kinect->next)
        if (strcmp(kinect->path, path) == 0)
            return kinect;
    return map_kinect(path);
}

/* KINECT_SIMULATOR lists control files, one per Kinect, separated by colons. It is read whenever
 * devices are listed: a program's libusb may outlive a test's Kinect. */
void look_up_kinects(struct libusb_context *context)
{
    char paths[PATH_ROOM], *rest = paths, *path;
    const char *variable = getenv("KINECT_SIMULATOR");
    snprintf(paths, sizeof paths, "%s", variable ? variable : "");
    if (strcmp(paths, context->paths) == 0)
        return;
    strcpy(context->paths, paths);
    context->kinect_count = 0;
    while ((path = strsep(&rest, ":")) && context->kinect_count < MAX_KINECTS) {
        struct kinect *kinect = *path ? kinect_of(path) : NULL;
        if (kinect)
            context->kinects[context->kinect_count++] = kinect;
    }
}

int libusb_init(libusb_context **out)
{
    struct libusb_context *context = calloc(1, sizeof *context);
    if (!context)
        return LIBUSB_ERROR_NO_MEM;
    pthread_mutex_lock(&bus_mutex);
    look_up_kinects(context);
    if (!default_context)
        default_context = context;
    pthread_mutex_unlock(&bus_mutex);
    if (out)
        *out = context;
    return LIBUSB_SUCCESS;
}

void libusb_exit(libusb_context *context)
{
    context = context_or_default(context);
    if (!context)
        return;
    while (context->handles)
        libusb_close(context->handles);
    pthread_mutex_lock(&bus_mutex);
    if (default_context == context)
        default_context = NULL;
    pthread_mutex_unlock(&bus_mutex);
    /* Not freed: its devices may live longer, and it is small. */
}

void libusb_set_debug(libusb_context *context, int level) { (void)context, (void)level; }

int libusb_set_option(libusb_context *context, int option, ...)
{
    (void)context, (void)option;
    return LIBUSB_SUCCESS;
}

/* No hot-plug callbacks: pyusb and libfreenect do not use them. */
int libusb_has_capability(uint32_t capability) { return capability == 0; }

int libusb_hotplug_register_callback(libusb_context *context, ...)
{
    (void)context;
    return LIBUSB_ERROR_NOT_SUPPORTED;
}

void libusb_hotplug_deregister_callback(libusb_context *context, int callback_handle)
{
    (void)context, (void)callback_handle;
}

const struct libusb_version *libusb_get_version(void)
{
    static const struct libusb_version version = {1, 0, 26, 0, "", "Kinect simulator"};
    return &version;
}

struct error_text {
    int code;
    const char *name, *text;
};

static const struct error_text *error_text(int code)
{
    static const struct error_text texts[] = {
        {LIBUSB_SUCCESS, "LIBUSB_SUCCESS", "Success"},
        {LIBUSB_ERROR_IO, "LIBUSB_ERROR_IO", "Input/Output Error"},
        {LIBUSB_ERROR_INVALID_PARAM, "LIBUSB_ERROR_INVALID_PARAM", "Invalid parameter"},
        {LIBUSB_ERROR_ACCESS, "LIBUSB_ERROR_ACCESS", "Access denied (insufficient permissions)"},
        {LIBUSB_ERROR_NO_DEVICE, "LIBUSB_ERROR_NO_DEVICE", "No such device (it may have been "
                                                           "disconnected)"},
        {LIBUSB_ERROR_NOT_FOUND, "LIBUSB_ERROR_NOT_FOUND", "Entity not found"},
        {LIBUSB_ERROR_BUSY, "LIBUSB_ERROR_BUSY", "Resource busy"},
        {LIBUSB_ERROR_TIMEOUT, "LIBUSB_ERROR_TIMEOUT", "Operation timed out"},
        {LIBUSB_ERROR_PIPE, "LIBUSB_ERROR_PIPE", "Pipe error"},
        {LIBUSB_ERROR_NO_MEM, "LIBUSB_ERROR_NO_MEM", "Insufficient memory"},
        {LIBUSB_ERROR_NOT_SUPPORTED, "LIBUSB_ERROR_NOT_SUPPORTED", "Operation not supported or "
                                                                   "unimplemented"},
    };
    static const struct error_text other = {LIBUSB_ERROR_OTHER, "LIBUSB_ERROR_OTHER",
                                            "Other error"};
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++)
        if (texts[i].code == code)
            return &texts[i];
    return &other;
}

const char *libusb_error_name(int code) { return error_text(code)->name; }
const char *libusb_strerror(int code) { return error_text(code)->text; }
