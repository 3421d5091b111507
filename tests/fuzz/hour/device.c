/* A V4L2 driver in front of the C library, with a hostile camera behind it.
 *
 * Promises that the kernel keeps are kept: lists end, an index is one of the buffers', no more
 * bytes are used than a buffer has. What a camera decides is anything: formats, sizes, rates,
 * bytes, flags, numbers, silence, and going away. VERGE_FAKE_CAMERA is the folder with the device
 * (an empty file, video0) and its pictures (picture0 to picture63). */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#define BUFFERS 8
#define PICTURES 64

static const unsigned formats[] = {
    V4L2_PIX_FMT_MJPEG, V4L2_PIX_FMT_YUYV, V4L2_PIX_FMT_NV12, V4L2_PIX_FMT_GREY};
static const unsigned sizes[][2] = {{3840, 2160}, {1920, 1080}, {640, 360}, {5328, 2997}, {0, 0}};

static int device = -1;
static unsigned mode, width, height, format, length, count, queued[BUFFERS], waiting, sequence;
static double next_frame;

static double now(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return time.tv_sec + time.tv_nsec * 1e-9;
}

static int one_in(int n) { return random() % n == 0; }

static int fails(int error) {
    errno = error;
    return -1;
}

/* Puts a picture of the camera's into the buffer that begins at `begin`; how many bytes it says it
 * has used. It is written to the file: pages that the driver mapped too would count twice. */
static unsigned fill(off_t begin) {
    static unsigned char piece[1 << 15];
    unsigned used = 0, changes = random() % 4;
    if (format != V4L2_PIX_FMT_MJPEG) {
        /* One row in twenty: reading is what is tested. */
        unsigned row = length / (height ? height : 1);
        unsigned part = row < sizeof piece ? row : sizeof piece;
        for (; part && used + row <= length; used += 20 * row) {
            memset(piece, random(), part);
            if (pwrite(device, piece, part, begin + used) < 0)
                return 0;
        }
        return one_in(4) ? random() % (length + 1) : length;
    }
    char path[512];
    snprintf(path, sizeof path, "%s/picture%ld", getenv("VERGE_FAKE_CAMERA"), random() % PICTURES);
    FILE *file = fopen(path, "r");
    if (!file)
        return 0;
    size_t got;
    while ((got = fread(piece, 1, sizeof piece, file)) && used < length) {
        got = got < length - used ? got : length - used;
        if (pwrite(device, piece, got, begin + used) < 0)
            break;
        used += got;
    }
    fclose(file);
    while (used && changes--) {
        piece[0] = random();
        if (pwrite(device, piece, 1, begin + random() % used) < 0)
            break;
    }
    return one_in(8) ? random() % (length + 1) : used;
}

static int enumerate_formats(struct v4l2_fmtdesc *it) {
    /* UVC counts formats in a byte. */
    unsigned most = mode == 1 ? 255 : 1;
    if (it->index >= most)
        return fails(EINVAL);
    it->pixelformat = it->index < 4 ? formats[(it->index + mode) % 4] : random();
    memset(it->description, one_in(40) ? 0xff : 'x', sizeof it->description);
    it->description[8] = 0;
    return 0;
}

static int enumerate_sizes(struct v4l2_frmsizeenum *it) {
    if (it->index >= (mode == 1 ? 255 : 1))
        return fails(EINVAL);
    if (mode == 3) {
        it->type = V4L2_FRMSIZE_TYPE_STEPWISE;
        it->stepwise = (struct v4l2_frmsize_stepwise){0, random(), random() % 3, 0, random(), 0};
        if (one_in(2))
            it->stepwise = (struct v4l2_frmsize_stepwise){16, 3840, 16, 9, 2160, 9};
        return 0;
    }
    it->type = one_in(50) ? 77 : V4L2_FRMSIZE_TYPE_DISCRETE;
    unsigned size = it->index ? random() % 5 : mode % 4;
    it->discrete = (struct v4l2_frmsize_discrete){sizes[size][0], sizes[size][1]};
    if (it->index > 8)
        it->discrete = (struct v4l2_frmsize_discrete){random() % 65536, random() % 65536};
    return 0;
}

static int enumerate_intervals(struct v4l2_frmivalenum *it) {
    if (it->index >= (mode == 1 ? 255 : 2))
        return fails(EINVAL);
    it->type = one_in(50) ? 77 : one_in(4) ? V4L2_FRMIVAL_TYPE_STEPWISE : V4L2_FRMIVAL_TYPE_DISCRETE;
    it->discrete = (struct v4l2_fract){it->index ? random() % 3 : 1, it->index ? random() % 3 : 5};
    return 0;
}

static int set_format(struct v4l2_format *it) {
    struct v4l2_pix_format *pix = &it->fmt.pix;
    if (one_in(40))
        pix->pixelformat = formats[random() % 4];
    if (one_in(40))
        pix->width /= 2;
    width = pix->width, height = pix->height, format = pix->pixelformat;
    unsigned row = format == V4L2_PIX_FMT_YUYV ? 2 * width : width;
    pix->bytesperline = one_in(8) ? random() : row;
    unsigned whole = format == V4L2_PIX_FMT_NV12 ? row * height * 3 / 2 : row * height;
    /* What a camera says of the size of its frames. */
    length = one_in(8) ? random() % (whole + 1) : whole;
    length = (length + 4095) / 4096 * 4096 + 4096;
    pix->sizeimage = length;
    pix->colorspace = random() % 14;
    pix->quantization = random() % 4;
    return 0;
}

static int request_buffers(struct v4l2_requestbuffers *it) {
    waiting = 0;
    count = it->count > BUFFERS ? BUFFERS : it->count;
    if (count && one_in(20))
        count = 1 + random() % count;
    it->count = count;
    if (ftruncate(device, 0) || ftruncate(device, (off_t)count * length))
        return fails(ENOMEM);
    return 0;
}

static int dequeue(struct v4l2_buffer *it) {
    next_frame = now() + (one_in(400) ? 15 : 0.2);
    if (one_in(60))
        return fails(one_in(2) ? ENODEV : EIO);
    if (!waiting)
        return fails(EAGAIN);
    it->index = queued[0];
    memmove(queued, queued + 1, --waiting * sizeof *queued);
    it->bytesused = fill((off_t)it->index * length);
    it->length = length;
    it->flags = one_in(10) ? V4L2_BUF_FLAG_ERROR : one_in(20) ? random() : 0;
    it->sequence = one_in(20) ? random() : ++sequence;
    it->field = random();
    it->timestamp = (struct timeval){one_in(20) ? -random() : random(), random()};
    return 0;
}

static int answer(unsigned long request, void *argument) {
    switch (request) {
    case VIDIOC_QUERYCAP: {
        struct v4l2_capability *it = argument;
        memset(it, 0, sizeof *it);
        memset(it->card, mode == 2 ? 0x1b : 'c', sizeof it->card - (mode == 2 ? 0 : 1));
        memset(it->driver, one_in(20) ? 0xff : 'd', sizeof it->driver - 1);
        it->capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
        if (one_in(20))
            it->capabilities = random();
        it->device_caps = it->capabilities;
        return 0;
    }
    case VIDIOC_ENUM_FMT: return enumerate_formats(argument);
    case VIDIOC_ENUM_FRAMESIZES: return enumerate_sizes(argument);
    case VIDIOC_ENUM_FRAMEINTERVALS: return enumerate_intervals(argument);
    case VIDIOC_S_FMT:
        return set_format(argument);
    case VIDIOC_G_FMT: {
        struct v4l2_pix_format *pix = &((struct v4l2_format *)argument)->fmt.pix;
        pix->width = width, pix->height = height, pix->pixelformat = format;
        return 0;
    }
    case VIDIOC_S_PARM:
    case VIDIOC_G_PARM:
        return one_in(4) ? fails(EINVAL) : 0;
    case VIDIOC_REQBUFS: return request_buffers(argument);
    case VIDIOC_QUERYBUF: {
        struct v4l2_buffer *it = argument;
        it->length = length;
        it->m.offset = it->index * length;
        return it->index < count ? 0 : fails(EINVAL);
    }
    case VIDIOC_QBUF: {
        struct v4l2_buffer *it = argument;
        if (it->index >= count || waiting == count)
            return fails(EINVAL);
        queued[waiting++] = it->index;
        return 0;
    }
    case VIDIOC_DQBUF: return dequeue(argument);
    case VIDIOC_STREAMON: return one_in(40) ? fails(ENOSPC) : 0;
    case VIDIOC_STREAMOFF: return one_in(40) ? fails(ENODEV) : (waiting = 0, 0);
    default: return fails(ENOTTY);
    }
}

static int is_ours(const char *path) {
    const char *folder = getenv("VERGE_FAKE_CAMERA");
    size_t length = folder ? strlen(folder) : 0;
    return length && !strncmp(path, folder, length) && !strcmp(path + length, "/video0");
}

static int opened(const char *path, int descriptor) {
    if (descriptor >= 0 && is_ours(path)) {
        /* Each time another camera. */
        static unsigned times;
        srandom(++times);
        mode = times % 5;
        device = descriptor;
        count = waiting = 0;
        next_frame = 0;
    }
    return descriptor;
}

int open(const char *path, int flags, ...) {
    va_list rest;
    va_start(rest, flags);
    int permissions = va_arg(rest, int);
    va_end(rest);
    return opened(path, syscall(SYS_openat, AT_FDCWD, path, flags, permissions));
}

int open64(const char *path, int flags, ...) {
    va_list rest;
    va_start(rest, flags);
    int permissions = va_arg(rest, int);
    va_end(rest);
    return opened(path, syscall(SYS_openat, AT_FDCWD, path, flags | O_LARGEFILE, permissions));
}

int close(int descriptor) {
    if (descriptor == device)
        device = -1;
    return syscall(SYS_close, descriptor);
}

long syscall(long number, ...) {
    static long (*real)(long, ...);
    if (!real)
        *(void **)&real = dlsym(RTLD_NEXT, "syscall");
    long a[6];
    va_list rest;
    va_start(rest, number);
    for (int n = 0; n < 6; n++)
        a[n] = va_arg(rest, long);
    va_end(rest);
    if (number == SYS_ioctl && (int)a[0] == device && (a[1] >> 8 & 0xff) == 'V')
        return answer(a[1] & 0xffffffff, (void *)a[2]);
    return real(number, a[0], a[1], a[2], a[3], a[4], a[5]);
}

int poll(struct pollfd *fds, nfds_t number, int timeout) {
    static int (*real)(struct pollfd *, nfds_t, int);
    if (!real)
        *(void **)&real = dlsym(RTLD_NEXT, "poll");
    if (number != 1 || fds->fd != device)
        return real(fds, number, timeout);
    double left = next_frame - now();
    if (left > 0 && timeout != 0) {
        double wait = timeout > 0 && timeout * 1e-3 < left ? timeout * 1e-3 : left;
        usleep(wait * 1e6);
        left = next_frame - now();
    }
    fds->revents = left > 0 ? 0 : POLLIN;
    return left > 0 ? 0 : 1;
}
