/* What a kernel that ptx.py has translated is made of, and what it and device.c share. */
#ifndef KERNEL_H
#define KERNEL_H
#include <math.h>
#include <stdint.h>
#include <string.h>

typedef uint8_t b8, u8;
typedef int8_t s8;
typedef uint16_t b16, u16, f16;
typedef int16_t s16;
typedef uint32_t b32, u32;
typedef int32_t s32, pred;
typedef uint64_t b64, u64;
typedef int64_t s64;
typedef float f32;
typedef double f64;

/* A register of PTX: instructions read it as their own type, whatever it was declared as. */
typedef union {
    b8 b8; u8 u8; s8 s8; b16 b16; u16 u16; s16 s16; f16 f16; b32 b32; u32 u32; s32 s32; b64 b64; u64 u64; s64 s64;
    f32 f32; f64 f64; pred pred;
} Register;

typedef struct { u32 is_hit, instance, primitive, attributes[2]; f32 distance; u64 data; } HitObject;

/* One lane of a launch. */
typedef struct Lane {
    u32 index, count;
    const u8 *params;
    const u16 *held; /* of each GRAIN bytes of memory, how many are allocated */
    void (*fail)(const char *format, ...);
    void (*trace)(struct Lane *, u64 scene, const f32 *ray, u32 mask, u32 offset, u32 stride);
    void *(*callable)(struct Lane *, u32 index);
    void (*sample)(struct Lane *, u64 texture, int dimensions, const f32 *place, f32 *texel);
    const void *table; /* OptiX's shader binding table */
    HitObject hit;
} Lane;

typedef void Callable(Lane *, u8 *result, const u8 *params, u32 index, u32 self, u64 data, u64 base);

#define GRAIN 256
#define MEMORY(type, address) (*(type *)(uintptr_t)(address))

/* The address, if a card could read or write `size` bytes there. */
static inline u64 checked(Lane *lane, u64 address, u32 size) {
    if (address % size) lane->fail("misaligned address %lx of %u bytes", address, size);
    if (address >> 47 || address % GRAIN + size > lane->held[address / GRAIN])
        lane->fail("%u bytes at %lx are not allocated", size, address);
    return address;
}

static inline u32 within(Lane *lane, u32 index, u32 count) {
    if (index >= count) lane->fail("entry %u of an array of %u", index, count);
    return index;
}

static inline f32 float_of(u32 bits) { Register r; r.u32 = bits; return r.f32; }
static inline f64 double_of(u64 bits) { Register r; r.u64 = bits; return r.f64; }

/* The result of an approximate instruction: up to ULPS units in the last place off, always the same for one number. */
static inline f32 approximate(f32 exact) {
    Register r;
    r.f32 = exact;
    if (ULPS && isfinite(exact) && fabsf(exact) > 1e-30f) r.u32 += (int)((r.u32 * 2654435761u >> 8) % (2 * ULPS + 1)) - ULPS;
    return r.f32;
}

/* The same of one whose error is absolute, from ULPS 2 on. Whole numbers stay, and none leaves [-1, 1]. */
static inline f32 displaced(f32 exact, f32 error) {
    Register r;
    r.f32 = exact;
    if (ULPS < 2) return approximate(exact);
    if (!isfinite(exact) || exact == rintf(exact)) return exact;
    f32 result = exact + error * ((r.u32 * 2654435761u >> 8) * 0x1p-23f - 1);
    return fabsf(exact) < 1 ? fmaxf(-1, fminf(1, result)) : result;
}

/* A number as an integer: a card takes the nearest there is, and 0 for what is none. */
static inline s64 to_signed(f64 x, int bits) {
    f64 end = ldexp(1, bits - 1);
    u64 low = (u64)1 << (bits - 1);
    return x != x ? 0 : x >= end ? (s64)(low - 1) : x < -end ? -(s64)(low - 1) - 1 : (s64)x;
}
static inline u64 to_unsigned(f64 x, int bits) {
    return !(x > 0) ? 0 : x >= ldexp(1, bits) ? ~(u64)0 >> (64 - bits) : (u64)x;
}

static inline u32 population(u64 x) { u32 n = 0; for (; x; x &= x - 1) n++; return n; }
static inline u32 leading_zeros(u64 x, u32 bits) { for (; x; x >>= 1) bits--; return bits; }
static inline u64 reversed(u64 x, int bits) { u64 r = 0; for (; bits--; x >>= 1) r = r << 1 | (x & 1); return r; }
static inline u64 high_half(u64 a, u64 b) {
    u64 low = (u32)a * (u64)(u32)b, one = (a >> 32) * (u32)b + (low >> 32), other = (u32)a * (b >> 32) + (u32)one;
    return (a >> 32) * (b >> 32) + (one >> 32) + (other >> 32);
}
#endif
