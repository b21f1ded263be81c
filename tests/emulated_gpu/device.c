/* A stand-in for NVIDIA's driver: CUDA and OptiX as Dr.Jit 1.5 and Mitsuba 3.9 call them, on the host's memory and threads.

   What these functions take is from drjit-core (src/cuda_api.h, src/optix_api.h, include/drjit-core/optix.h; the kernels
   that it brings along: resources/), from Mitsuba (include/mitsuba/render/optix_api.h), and, for what rays hit, from Embree 3,
   which Mitsuba brings along. A launch is done when its call returns, so that streams and events have nothing to do. */
#define _GNU_SOURCE
#include "kernel.h"
#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>
#include <xmmintrin.h>

#define EXPORT __attribute__((visibility("default")))
typedef int Result;
typedef void Entry(Lane *);

static void fail(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    fputs("emulated GPU: ", stderr);
    vfprintf(stderr, format, arguments);
    fputs("\n", stderr);
    va_end(arguments);
    abort();
}

/* ---- Memory. A shadow of 16 bits for each grain says how much of it is allocated; only pages that are used exist. */

static u16 *held;

static Result allocate(void **result, size_t size) {
    char *start = NULL;
    if (posix_memalign((void **)&start, GRAIN, size + GRAIN)) return 2; /* out of memory */
    memset(start, 0xff, size + GRAIN); /* what a card holds there: here none of it is a number */
    u16 *grain = held + (uintptr_t)start / GRAIN;
    for (size_t done = 0; done < size; done += GRAIN) *grain++ = size - done < GRAIN ? size - done : GRAIN;
    *result = start;
    return 0;
}

static Result release(void *start) {
    /* The grain behind an allocation is its own as well, so that none follows at once. */
    for (u16 *grain = held + (uintptr_t)start / GRAIN; *grain; *grain++ = 0) {}
    free(start);
    return 0;
}

EXPORT Result cuMemAlloc_v2(void **p, size_t n) { return allocate(p, n); }
EXPORT Result cuMemAllocAsync(void **p, size_t n, void *stream) { return allocate(p, n); }
EXPORT Result cuMemAllocHost_v2(void **p, size_t n) { return allocate(p, n); }
EXPORT Result cuMemFree_v2(void *p) { return release(p); }
EXPORT Result cuMemFreeAsync(void *p, void *stream) { return release(p); }
EXPORT Result cuMemFreeHost(void *p) { return release(p); }
EXPORT Result cuMemcpy(void *to, const void *from, size_t n) { memmove(to, from, n); return 0; }
EXPORT Result cuMemcpyAsync(void *to, const void *from, size_t n, void *stream) { return cuMemcpy(to, from, n); }
EXPORT Result cuMemsetD8Async(void *p, u8 v, size_t n, void *stream) { memset(p, v, n); return 0; }
EXPORT Result cuMemsetD16Async(u16 *p, u16 v, size_t n, void *stream) { while (n--) *p++ = v; return 0; }
EXPORT Result cuMemsetD32Async(u32 *p, u32 v, size_t n, void *stream) { while (n--) *p++ = v; return 0; }
EXPORT Result cuPointerGetAttribute(int *value, int attribute, void *p) { *value = 2; return 0; } /* a device's */

/* ---- What a card says of itself. */

EXPORT Result cuInit(unsigned flags) {
    size_t size = ((size_t)1 << 47) / GRAIN * sizeof *held;
    if (held) return 0;
    held = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (held == MAP_FAILED) fail("this system gives no process an address space of 1 TiB");
    return 0;
}
EXPORT Result cuDriverGetVersion(int *version) { *version = 12080; return 0; } /* CUDA 12.8 */
EXPORT Result cuDeviceGetCount(int *n) { *n = 1; return 0; }
EXPORT Result cuDeviceGet(int *device, int i) { *device = i; return 0; }
EXPORT Result cuDeviceGetName(char *name, int size, int device) { snprintf(name, size, "Emulated GPU"); return 0; }
EXPORT Result cuDeviceTotalMem_v2(size_t *size, int device) { *size = (size_t)80 << 30; return 0; }
EXPORT Result cuDeviceGetAttribute(int *value, int attribute, int device) {
    switch (attribute) { /* numbers of CUdevice_attribute; values of an H100 */
        case 16: *value = 132; break;    /* multiprocessors */
        case 75: *value = 9; break;      /* compute capability, major */
        case 33: case 34: case 50: case 76: *value = 0; break; /* its place on the PCI bus; minor */
        case 97: *value = 232448; break; /* shared memory of a block */
        default: *value = 1;             /* what Dr.Jit asks else is whether it can */
    }
    return 0;
}
EXPORT Result cuOccupancyMaxPotentialBlockSize(int *blocks, int *size, void *f, void *g, size_t shared, int limit) {
    *blocks = 264;
    *size = 256;
    return 0;
}
EXPORT Result cuDeviceCanAccessPeer(int *can, int one, int other) { *can = 0; return 0; }
EXPORT Result cuGetErrorName(Result code, const char **text) { *text = "an error of the emulated GPU"; return 0; }
EXPORT Result cuGetErrorString(Result code, const char **text) { return cuGetErrorName(code, text); }
EXPORT Result cuLaunchHostFunc(void *stream, void (*function)(void *), void *data) { function(data); return 0; }
EXPORT Result cuEventElapsedTime(float *milliseconds, void *start, void *end) { *milliseconds = 1; return 0; }

/* Contexts, streams and events are addresses of nothing. */
#define HANDLE(name, ...) EXPORT Result name(void **handle, ##__VA_ARGS__) { static char it; *handle = &it; return 0; }
HANDLE(cuDevicePrimaryCtxRetain, int device)
HANDLE(cuStreamCreate, unsigned flags)
HANDLE(cuEventCreate, unsigned flags)
#define DONE(name) EXPORT Result name() { return 0; }
DONE(cuDevicePrimaryCtxRelease_v2) DONE(cuCtxPushCurrent_v2) DONE(cuCtxPopCurrent_v2) DONE(cuCtxSynchronize)
DONE(cuCtxEnablePeerAccess) DONE(cuEventDestroy_v2) DONE(cuEventRecord) DONE(cuEventSynchronize) DONE(cuEventQuery)
DONE(cuStreamDestroy_v2) DONE(cuStreamSynchronize) DONE(cuStreamWaitEvent) DONE(cuStreamWaitEvent_ptsz) DONE(cuMemAdvise)
DONE(cuFuncSetAttribute) DONE(cuModuleUnload) DONE(cuProfilerStart) DONE(cuProfilerStop)
#define MISSING(name) EXPORT Result name() { fail("has no " #name); return 801; }
MISSING(cuArray3DCreate_v2) MISSING(cuArray3DGetDescriptor_v2) MISSING(cuMemcpy3DAsync_v2) MISSING(cuMipmappedArrayCreate)
MISSING(cuMipmappedArrayGetLevel) MISSING(cuMipmappedArrayDestroy) MISSING(cuTexObjectGetResourceDesc)
MISSING(cuSurfObjectCreate) MISSING(cuSurfObjectDestroy) MISSING(cuGraphicsGLRegisterBuffer) MISSING(cuGraphicsGLRegisterImage)
MISSING(cuGraphicsMapResources) MISSING(cuGraphicsResourceGetMappedPointer) MISSING(cuGraphicsSubResourceGetMappedArray)
MISSING(cuGraphicsUnmapResources) MISSING(cuGraphicsUnregisterResource)

/* ---- Textures of one or two dimensions, of floats or bytes. */

typedef struct { size_t width, height; int format; unsigned channels; u8 *texels; } Array; /* CUDA_ARRAY_DESCRIPTOR, and texels */
typedef struct { int kind; Array *array; } Resource;                                       /* CUDA_RESOURCE_DESC */
typedef struct { int address[3], filter; unsigned flags; } Sampler;                        /* CUDA_TEXTURE_DESC */
typedef struct { Array *array; Sampler sampler; } Texture;
typedef struct { size_t x, y; int kind; void *host; u8 *device; Array *array; size_t pitch; } Side;
typedef struct { Side from, to; size_t width, height; } Copy; /* CUDA_MEMCPY2D */

static size_t texel_size(const Array *array) { return array->channels * (array->format == 0x20 ? 4 : 1); }

EXPORT Result cuArrayCreate_v2(Array **result, const Array *description) {
    Array *array = *result = malloc(sizeof *array);
    *array = *description;
    if (array->format != 0x20 && array->format != 1) fail("has no textures of format %d", array->format);
    if (!array->height) array->height = 1;
    array->texels = calloc(array->width * array->height, texel_size(array));
    return 0;
}
EXPORT Result cuArrayDestroy(Array *array) { free(array->texels); free(array); return 0; }
EXPORT Result cuTexObjectCreate(Texture **result, const Resource *resource, const Sampler *sampler, const void *view) {
    if (sampler->flags & ~2u || sampler->filter > 1) fail("has no textures with flags %x", sampler->flags); /* 2: in shares */
    *result = malloc(sizeof **result);
    **result = (Texture){resource->array, *sampler};
    return 0;
}
EXPORT Result cuTexObjectDestroy(Texture *texture) { free(texture); return 0; }

static u8 *row_of(const Side *side, size_t row) {
    if (side->kind == 1) fail("has no copies of textures from the host");
    if (side->kind == 3) return side->array->texels + (side->y + row) * side->array->width * texel_size(side->array) + side->x;
    return side->device + (side->y + row) * side->pitch + side->x;
}
EXPORT Result cuMemcpy2DAsync_v2(const Copy *copy, void *stream) {
    for (size_t row = 0; row < copy->height; row++) memmove(row_of(&copy->to, row), row_of(&copy->from, row), copy->width);
    return 0;
}

/* The texel's number along an axis: repeated (0), that of the border (1) or mirrored (2). */
static long texel_along(long i, long n, int mode) {
    if (mode == 1) return i < 0 ? 0 : i >= n ? n - 1 : i;
    long period = mode == 2 ? 2 * n : n, k = (i % period + period) % period;
    return k < n ? k : period - 1 - k;
}

static void sample(Lane *lane, u64 handle, int dimensions, const f32 *place, f32 *texel) {
    const Texture *texture = (const Texture *)handle;
    const Array *array = texture->array;
    size_t sizes[2] = {array->width, array->height};
    long low[2] = {0, 0};
    f32 weight[2] = {0, 0};
    if (dimensions > 2) fail("has no textures of three dimensions");
    for (int axis = 0; axis < dimensions; axis++) {
        f32 x = place[axis] * (texture->sampler.flags & 2 ? sizes[axis] : 1) - (texture->sampler.filter ? 0.5f : 0);
        low[axis] = (long)floorf(x);
        if (texture->sampler.filter) weight[axis] = rintf((x - floorf(x)) * 256) / 256; /* a card's have 8 bits */
    }
    memset(texel, 0, 4 * sizeof *texel);
    for (int corner = 0; corner < 4; corner++) {
        f32 share = (corner & 1 ? weight[0] : 1 - weight[0]) * (corner & 2 ? weight[1] : 1 - weight[1]);
        if (!share) continue;
        long x = texel_along(low[0] + (corner & 1), sizes[0], texture->sampler.address[0]);
        long y = texel_along(low[1] + (corner >> 1), sizes[1], texture->sampler.address[1]);
        const u8 *start = array->texels + (y * array->width + x) * texel_size(array);
        for (unsigned k = 0; k < array->channels; k++)
            texel[k] += share * (array->format == 0x20 ? ((const f32 *)start)[k] : start[k] / 255.0f);
    }
}

/* ---- Kernels: translated, or one of those that Dr.Jit brings along, by its name. */

typedef struct { void *library; } Module;
typedef struct { Entry *entry; char name[64]; } Function;

/* Compile a module into a shared library; its file is kept by the hash of its text. */
static void *translated(const char *ptx, size_t size) {
    u64 hash = 1469598103934665603ull; /* FNV-1a */
    char library[sizeof FOLDER + 32], file_name[sizeof FOLDER + 64], command[sizeof COMPILE + 512];
    for (size_t i = 0; i < size; i++) hash = (hash ^ (u8)ptx[i]) * 1099511628211ull;
    sprintf(library, "%s/%016lx.so", FOLDER, hash);
    void *handle = dlopen(library, RTLD_NOW | RTLD_LOCAL);
    if (!handle) {
        /* Two processes, or two threads, may compile the same: each renames what is whole. */
        static int number;
        sprintf(file_name, "%s/%016lx.%d.%d.ptx", FOLDER, hash, (int)getpid(), __sync_fetch_and_add(&number, 1));
        FILE *file = fopen(file_name, "w");
        if (!file || fwrite(ptx, 1, size, file) != size || fclose(file)) fail("cannot write %s", file_name);
        sprintf(command, COMPILE, file_name + sizeof FOLDER, library + sizeof FOLDER);
        if (system(command)) abort(); /* ptx.py or the compiler has said why */
        if (!(handle = dlopen(library, RTLD_NOW | RTLD_LOCAL))) fail("%s", dlerror());
    }
    return handle;
}

EXPORT Result cuModuleLoadData(Module **result, const char *ptx) {
    Module *module = *result = calloc(1, sizeof *module);
    if (!strstr(ptx, "Generated by NVIDIA")) module->library = translated(ptx, strlen(ptx));
    return 0;
}
EXPORT Result cuModuleLoadDataEx(Module **result, const char *ptx, unsigned n, int *options, void **values) {
    return cuModuleLoadData(result, ptx);
}
EXPORT Result cuModuleGetFunction(Function **result, Module *module, const char *name) {
    Function *function = *result = calloc(1, sizeof *function);
    snprintf(function->name, sizeof function->name, "%s", name);
    if (module->library && !(function->entry = (Entry *)dlsym(module->library, name))) fail("no kernel %s", name);
    return 0;
}

/* Reduce values in turn; keep, if asked, what there is after each of them, or before it. */
#define REDUCTION(T, both, either)                                                                                     \
    static void reduce_##T(const T *in, T *out, T *kept, size_t first, size_t end, char op, int reverse, int before) { \
        T a = op == 'u';                                                                                               \
        for (size_t k = first; k < end; k++) {                                                                         \
            size_t i = reverse ? end - 1 - (k - first) : k;                                                            \
            T b = in[i], earlier = a;                                                                                  \
            if (k == first) a = b;                                                                                     \
            else if (op == 'd') a += b;                                                                                \
            else if (op == 'u') a *= b;                                                                                \
            else if (op == 'i') a = b < a ? b : a;                                                                     \
            else if (op == 'a') a = b > a ? b : a;                                                                     \
            else if (op == 'n') a = both;                                                                              \
            else a = either;                                                                                           \
            if (kept) kept[i] = before ? earlier : a;                                                                  \
        }                                                                                                              \
        if (out) *out = a;                                                                                             \
    }
#define EACH_TYPE(M) M(f32, a, a) M(f64, a, a) M(u8, a & b, a | b) M(s8, a & b, a | b) M(u32, a & b, a | b) \
    M(s32, a & b, a | b) M(u64, a & b, a | b) M(s64, a & b, a | b)
EACH_TYPE(REDUCTION)

static void reduce(const char *type, const void *in, void *out, size_t at, void *kept, size_t first, size_t end, char op,
                   int reverse, int before) {
#define OF_TYPE(T, both, either) \
    if (!strcmp(type, #T)) return reduce_##T(in, out ? (T *)out + at : NULL, kept, first, end, op, reverse, before);
    EACH_TYPE(OF_TYPE)
    fail("has no reduction of %s", type);
}

#define ARGUMENT(type, k) (*(type *)arguments[k])

static void run_builtin(const char *name, unsigned blocks, void **arguments) {
    char op[4] = "", type[4] = "", tail[24] = "";
    if (sscanf(name, "block_%*[a-z]_reduce_%3[a-z]_%3[a-z0-9]", op, type) == 2 ||
        sscanf(name, "block_reduce_%3[a-z]_%3[a-z0-9]_%23s", op, type, tail) == 3) {
        if (type[0] == 'i') type[0] = 's';
    }
    if (!strncmp(name, "block_reduce_", 13)) {
        const struct { const void *in; void *out; u32 size, block, chunks, count; u8 x; } *p = arguments[0];
        int bytes = atoi(type + 1) / 8, chunk = atoi(tail[0] == 'v' ? tail + 4 : tail), packet = tail[0] == 'v' ? 16 / bytes : 1;
        size_t size = (size_t)p->size * packet, block = (size_t)p->block * packet;
        for (size_t start = 0, k = 0; start < size; start += block)
            for (size_t part = 0; part < p->chunks; part++, k++) {
                size_t end = start + block < size ? start + block : size, first = start + part * chunk;
                size_t last = p->chunks > 1 && first + chunk < end ? first + chunk : end;
                reduce(type, p->in, p->out, k, NULL, first < last ? first : last, last, op[1], 0, 0);
            }
    } else if (!strncmp(name, "block_prefix_reduce_", 20)) {
        const struct { const void *in, *scratch; void *out; u32 size, block, chunks; u8 x, exclusive, reverse; } *p = arguments[0];
        for (size_t start = 0; start < p->size; start += p->block) {
            size_t end = start + p->block < p->size ? start + p->block : p->size;
            reduce(type, p->in, NULL, 0, p->out, start, end, op[1], p->reverse, p->exclusive);
        }
    } else if (!strncmp(name, "compress_", 9)) {
        const u8 *in = ARGUMENT(u8 *, 0);
        u32 *out = ARGUMENT(u32 *, 1), count = 0, is_small = name[9] == 's';
        if (!strcmp(name, "compress_large_init")) return;
        /* A large one has 2048 values a block, the last ones of them 0. */
        for (u32 i = 0, size = is_small ? ARGUMENT(u32, 2) : blocks * 2048; i < size; i++)
            if (in[i]) out[count++] = i;
        *ARGUMENT(u32 *, 3) = count;
    } else if (!strcmp(name, "aggregate")) {
        const struct { s16 size; u16 kind; u32 offset; void *from; } *p = ARGUMENT(void *, 1);
        for (u32 i = 0; i < ARGUMENT(u32, 2); i++) /* a value, or, of negative size, where it is */
            memcpy(ARGUMENT(u8 *, 0) + p[i].offset, p[i].size > 0 ? (void *)&p[i].from : p[i].from, abs(p[i].size));
    } else if (!strcmp(name, "fill_64")) {
        for (u32 i = 0; i < ARGUMENT(u32, 1); i++) ARGUMENT(u64 *, 0)[i] = ARGUMENT(u64, 2);
    } else if (!strncmp(name, "poke_", 5)) {
        memcpy(ARGUMENT(void *, 0), arguments[1], atoi(name + 6) / 8);
    } else {
        fail("has no kernel %s", name);
    }
}

static void run_lanes(Entry *entry, Lane lane, u32 count) {
    unsigned mode = _mm_getcsr();
    _mm_setcsr(mode | 0x8040); /* numbers below the smallest normal one are 0, as `.ftz` has it */
    lane.count = count;
    lane.held = held;
    lane.fail = fail;
    lane.sample = sample;
    for (lane.index = 0; lane.index < count; lane.index++) entry(&lane);
    _mm_setcsr(mode);
}

EXPORT Result cuLaunchKernel(Function *f, unsigned blocks, unsigned y, unsigned z, unsigned threads, unsigned ty, unsigned tz,
                             unsigned shared, void *stream, void **arguments, void **extra) {
    Lane lane = {0};
    if (!f->entry) return run_builtin(f->name, blocks * y, arguments), 0;
    for (; *extra; extra += 2)
        if (*extra == (void *)1) lane.params = extra[1]; /* CU_LAUNCH_PARAM_BUFFER_POINTER */
    run_lanes(f->entry, lane, blocks * threads);
    return 0;
}

#include "optix.h"
