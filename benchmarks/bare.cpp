// The least that a frame's rays can cost: closest hits and shadow rays by Embree, and nothing else.
//
// The same triangles, rays and order as `table1-apd` has, in packets of 16 with the settings with which Mitsuba asks.
// No beams are fired, no BSDF is looked at and nothing is detected. `bare.py` compiles and calls it.

#include <embree3/rtcore.h>

#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <thread>
#include <vector>

#ifdef RTC_NAMESPACE_USE
RTC_NAMESPACE_USE
#endif

namespace {

constexpr int PACKET = 16, BLOCK = 1024;
constexpr float FAR = std::numeric_limits<float>::infinity();

struct Rays {
    const float *origin, *x, *y, *z, *sun;
    float offset;
    size_t count;
    float *t;
    unsigned char *lit;
};

void trace_packet(RTCScene scene, const Rays &rays, size_t first) {
    alignas(64) int valid[PACKET], sunny[PACKET];
    alignas(64) RTCRayHit16 hit;
    alignas(64) RTCRay16 shadow;
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    for (int i = 0; i < PACKET; i++) {
        size_t ray = first + i < rays.count ? first + i : rays.count - 1;
        valid[i] = first + i < rays.count ? -1 : 0;
        hit.ray.org_x[i] = rays.origin[0], hit.ray.org_y[i] = rays.origin[1], hit.ray.org_z[i] = rays.origin[2];
        hit.ray.dir_x[i] = rays.x[ray], hit.ray.dir_y[i] = rays.y[ray], hit.ray.dir_z[i] = rays.z[ray];
        hit.ray.tnear[i] = 0.f, hit.ray.tfar[i] = FAR, hit.ray.time[i] = 0.f;
        hit.ray.mask[i] = 0xffffffff, hit.ray.flags[i] = 0, hit.ray.id[i] = 0;
        hit.hit.geomID[i] = hit.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
    }
    rtcIntersect16(valid, scene, &context, &hit);
    for (int i = 0; i < PACKET; i++) {
        const bool found = valid[i] && hit.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID;
        float nx = hit.hit.Ng_x[i], ny = hit.hit.Ng_y[i], nz = hit.hit.Ng_z[i];
        const float dx = hit.ray.dir_x[i], dy = hit.ray.dir_y[i], dz = hit.ray.dir_z[i];
        const float facing = nx * dx + ny * dy + nz * dz > 0.f ? -1.f : 1.f;
        const float scale = facing / std::sqrt(nx * nx + ny * ny + nz * nz);
        nx *= scale, ny *= scale, nz *= scale;
        const bool bright = nx * rays.sun[0] + ny * rays.sun[1] + nz * rays.sun[2] > 0.f;
        sunny[i] = found && bright ? -1 : 0;
        const float t = found ? hit.ray.tfar[i] : 0.f;
        shadow.org_x[i] = rays.origin[0] + t * dx + rays.offset * nx;
        shadow.org_y[i] = rays.origin[1] + t * dy + rays.offset * ny;
        shadow.org_z[i] = rays.origin[2] + t * dz + rays.offset * nz;
        shadow.dir_x[i] = rays.sun[0], shadow.dir_y[i] = rays.sun[1], shadow.dir_z[i] = rays.sun[2];
        shadow.tnear[i] = 0.f, shadow.tfar[i] = FAR, shadow.time[i] = 0.f;
        shadow.mask[i] = 0xffffffff, shadow.flags[i] = 0, shadow.id[i] = 0;
        if (valid[i]) rays.t[first + i] = found ? hit.ray.tfar[i] : FAR;
    }
    rtcOccluded16(sunny, scene, &context, &shadow);
    // A ray that is stopped has a length of minus infinity.
    for (int i = 0; i < PACKET; i++)
        if (valid[i]) rays.lit[first + i] = sunny[i] && shadow.tfar[i] > 0.f;
}

}  // namespace

extern "C" void *bare_scene(const float *vertices, size_t vertex_count, const unsigned *faces, size_t face_count) {
    RTCDevice device = rtcNewDevice("");
    RTCScene scene = rtcNewScene(device);
    rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_HIGH);
    rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
    RTCGeometry mesh = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    std::memcpy(rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, vertex_count),
                vertices, 12 * vertex_count);
    std::memcpy(rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, face_count), faces,
                12 * face_count);
    rtcCommitGeometry(mesh);
    rtcAttachGeometry(scene, mesh);
    rtcReleaseGeometry(mesh);
    rtcCommitScene(scene);
    rtcReleaseDevice(device);
    return scene;
}

extern "C" void bare_trace(void *scene, const float *origin, const float *x, const float *y, const float *z,
                           size_t count, const float *sun, float offset, int threads, float *t, unsigned char *lit) {
    const Rays rays{origin, x, y, z, sun, offset, count, t, lit};
    std::atomic<size_t> next{0};
    auto work = [&] {
        for (size_t first; (first = next.fetch_add(BLOCK)) < count;)
            for (size_t packet = first; packet < first + BLOCK && packet < count; packet += PACKET)
                trace_packet(static_cast<RTCScene>(scene), rays, packet);
    };
    std::vector<std::thread> others;
    for (int i = 1; i < threads; i++) others.emplace_back(work);
    work();
    for (auto &other : others) other.join();
}
