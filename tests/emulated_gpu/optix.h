/* OptiX on Embree 3: scenes of triangles, instances and spheres, tables of shapes, and launches. Included by device.c.

   Its structures are those of mitsuba/render/optix_api.h and drjit-core/optix.h. */

/* Embree's functions, which Mitsuba has in a namespace of its own. */
typedef struct {
    f32 from[3], near, to[3], time, far;
    u32 mask, id, flags;
    f32 normal[3], u, v;
    u32 primitive, geometry, instance;
} __attribute__((aligned(16))) RayHit;
typedef struct { int flags; void *filter; u32 instance; Lane *lane; const struct Accel *accel; u32 offset, stride; } Query;
typedef struct { void *user; u32 primitive, step; f32 *bounds; } BoundsArguments;
typedef struct { int *valid; void *user; u32 primitive; Query *query; RayHit *ray; u32 count, geometry; } IntersectArguments;
enum { TRIANGLES = 0, SPHERES = 120, INSTANCE = 121, INDICES = 0, VERTICES = 1, UINT3 = 0x5003, FLOAT3 = 0x9003, FLOAT3X4 = 0x9234 };
#define EMBREE(result, name, mangled, ...) result name(__VA_ARGS__) __asm__("_ZN7mitsuba" mangled);
EMBREE(void *, rtcNewDevice, "12rtcNewDeviceEPKc", const char *)
EMBREE(void *, rtcNewScene, "11rtcNewSceneEPNS_11RTCDeviceTyE", void *device)
EMBREE(void, rtcSetSceneFlags, "16rtcSetSceneFlagsEPNS_10RTCSceneTyENS_13RTCSceneFlagsE", void *scene, int)
EMBREE(void, rtcCommitScene, "14rtcCommitSceneEPNS_10RTCSceneTyE", void *scene)
EMBREE(void, rtcReleaseScene, "15rtcReleaseSceneEPNS_10RTCSceneTyE", void *scene)
EMBREE(void *, rtcNewGeometry, "14rtcNewGeometryEPNS_11RTCDeviceTyENS_15RTCGeometryTypeE", void *device, int type)
EMBREE(void *, rtcSetNewGeometryBuffer, "23rtcSetNewGeometryBufferEPNS_13RTCGeometryTyENS_13RTCBufferTypeEjNS_9RTCFormatEmm",
       void *geometry, int kind, u32 slot, int format, size_t stride, size_t count)
EMBREE(void, rtcSetGeometryInstancedScene, "28rtcSetGeometryInstancedSceneEPNS_13RTCGeometryTyEPNS_10RTCSceneTyE",
       void *geometry, void *scene)
EMBREE(void, rtcSetGeometryTransform, "23rtcSetGeometryTransformEPNS_13RTCGeometryTyEjNS_9RTCFormatEPKv", void *geometry,
       u32 step, int format, const void *)
EMBREE(void, rtcSetGeometryMask, "18rtcSetGeometryMaskEPNS_13RTCGeometryTyEj", void *geometry, u32 mask)
EMBREE(void, rtcSetGeometryUserPrimitiveCount, "32rtcSetGeometryUserPrimitiveCountEPNS_13RTCGeometryTyEj", void *geometry, u32)
EMBREE(void, rtcSetGeometryUserData, "22rtcSetGeometryUserDataEPNS_13RTCGeometryTyEPv", void *geometry, void *)
EMBREE(void, rtcSetGeometryBoundsFunction, "28rtcSetGeometryBoundsFunctionEPNS_13RTCGeometryTyEPFvPKNS_26RTCBoundsFunctionArgumentsEEPv",
       void *geometry, void (*)(const BoundsArguments *), void *)
EMBREE(void, rtcSetGeometryIntersectFunction, "31rtcSetGeometryIntersectFunctionEPNS_13RTCGeometryTyEPFvPKNS_30RTCIntersectFunctionNArgumentsEE",
       void *geometry, void (*)(const IntersectArguments *))
EMBREE(void, rtcCommitGeometry, "17rtcCommitGeometryEPNS_13RTCGeometryTyE", void *geometry)
EMBREE(u32, rtcAttachGeometry, "17rtcAttachGeometryEPNS_10RTCSceneTyEPNS_13RTCGeometryTyE", void *scene, void *geometry)
EMBREE(void, rtcReleaseGeometry, "18rtcReleaseGeometryEPNS_13RTCGeometryTyE", void *geometry)
EMBREE(void, rtcIntersect1, "13rtcIntersect1EPNS_10RTCSceneTyEPNS_19RTCIntersectContextEPNS_9RTCRayHitE", void *scene, Query *, RayHit *)

/* ---- Scenes. The handle of one is its address. */

typedef struct { u64 *vertices; u32 n_vertices, format, vertex_stride; u64 indices; u32 n_triangles, index_format, index_stride;
                 u64 transform; u32 *flags, n_records; } Triangles;
typedef struct { u64 *boxes; u32 count, stride, *flags, n_records; } Boxes;
typedef struct { f32 place[12]; u32 id, offset, mask, flags; struct Accel *accel; u64 unused; } Instance;
typedef struct { u64 instances; u32 count; } Instances;
typedef struct { int kind; union { Triangles triangles; Boxes boxes; Instances instances; char size[1024]; }; } BuildInput;
typedef struct { const u8 *boxes; u32 stride, record; } Shape;
typedef struct Accel { void *scene; Instance *instances; Shape *shapes; } Accel;
typedef struct { u64 magic; Accel *accel; } Mark; /* stands in the memory that a scene is given */
enum { MAGIC = 0x5ce9e, RECORD_HEADER = 32 };

typedef struct { u64 raygen, exception, miss; u32 miss_stride, n_miss; u64 hit; u32 hit_stride, n_hit;
                 u64 callable; u32 callable_stride, n_callables; } Table;
typedef struct { Entry *entry; const char *intersection; } Program; /* the header of a record holds its address */

static u64 record_of(const Query *query, u32 instance, u32 geometry) {
    const Accel *accel = query->accel;
    const Table *table = query->lane->table;
    u32 index = query->offset;
    if (accel->instances) index += accel->instances[instance].offset, accel = accel->instances[instance].accel;
    index += accel->shapes[geometry].record * query->stride;
    if (index >= table->n_hit) fail("shape %u of a table of %u", index, table->n_hit);
    return table->hit + (u64)index * table->hit_stride;
}

static void set_bounds(const BoundsArguments *arguments) {
    const Shape *shape = arguments->user;
    const f32 *box = (const f32 *)(shape->boxes + (size_t)arguments->primitive * shape->stride);
    memcpy(arguments->bounds, box, 12);
    memcpy(arguments->bounds + 4, box + 3, 12);
}

/* The nearest place where a ray meets the sphere of Mitsuba's record: a pointer to centre and radius behind a number. */
static void meet_sphere(const IntersectArguments *arguments) {
    RayHit *ray = arguments->ray;
    u64 record = record_of(arguments->query, arguments->query->instance, arguments->geometry);
    const char *name = MEMORY(Program *, record)->intersection;
    const f32 *sphere = MEMORY(f32 *, record + RECORD_HEADER + 8);
    f64 a = 0, b = 0, c = -(f64)sphere[3] * sphere[3];
    if (!name || strcmp(name, "__intersection__sphere")) fail("has no %s", name ? name : "such shape");
    for (int k = 0; k < 3; k++) {
        f64 from = (f64)ray->from[k] - sphere[k];
        a += (f64)ray->to[k] * ray->to[k], b += from * ray->to[k], c += from * from;
    }
    f64 root = sqrt(b * b - a * c), near = (-b - root) / a, far = (-b + root) / a, t = near < 0 ? far : near;
    if (!*arguments->valid || !(t >= ray->near && t < ray->far)) return; /* none, too, where there is no root */
    ray->far = t, ray->u = ray->v = 0;
    ray->primitive = arguments->primitive, ray->geometry = arguments->geometry, ray->instance = arguments->query->instance;
}

static void copy_rows(void *to, u64 from, u32 stride, size_t count) {
    for (size_t k = 0; k < count; k++) memcpy((char *)to + 12 * k, (const char *)from + k * (stride ? stride : 12), 12);
}

static void *geometry_of(const BuildInput *input, void *device, Shape *shape, u32 *record) {
    const Triangles *t = &input->triangles;
    if (input->kind != 0x2141 && input->kind != 0x2142) fail("has no shapes of kind %x", input->kind);
    int is_mesh = input->kind == 0x2141;
    void *geometry = rtcNewGeometry(device, is_mesh ? TRIANGLES : SPHERES);
    shape->record = *record;
    *record += is_mesh ? t->n_records : input->boxes.n_records;
    if (is_mesh) {
        if (t->transform) fail("has no meshes with a transform");
        copy_rows(rtcSetNewGeometryBuffer(geometry, VERTICES, 0, FLOAT3, 12, t->n_vertices), *t->vertices, t->vertex_stride, t->n_vertices);
        copy_rows(rtcSetNewGeometryBuffer(geometry, INDICES, 0, UINT3, 12, t->n_triangles), t->indices, t->index_stride, t->n_triangles);
    } else {
        shape->stride = input->boxes.stride ? input->boxes.stride : 24;
        shape->boxes = (const u8 *)*input->boxes.boxes;
        rtcSetGeometryUserPrimitiveCount(geometry, input->boxes.count);
        rtcSetGeometryUserData(geometry, shape);
        rtcSetGeometryBoundsFunction(geometry, set_bounds, NULL);
        rtcSetGeometryIntersectFunction(geometry, meet_sphere);
    }
    return geometry;
}

static void *instance_of(const Instance *instance, void *device) {
    const f32 *m = instance->place; /* rows; Embree takes columns */
    f32 columns[12] = {m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10], m[3], m[7], m[11]};
    void *geometry = rtcNewGeometry(device, INSTANCE);
    rtcSetGeometryInstancedScene(geometry, instance->accel->scene);
    rtcSetGeometryTransform(geometry, 0, FLOAT3X4, columns);
    rtcSetGeometryMask(geometry, instance->mask);
    return geometry;
}

static Result build(void *context, void *stream, void *options, const BuildInput *inputs, u32 count, void *room, size_t n_room,
                    Mark *output, size_t n_output, Accel **result, void **emitted, u32 n_emitted) {
    static void *device;
    if (!device) device = rtcNewDevice("threads=1");
    Accel *accel = *result = calloc(1, sizeof *accel);
    const Instances *instances = inputs->kind == 0x2143 ? &inputs->instances : NULL;
    u32 n = instances ? instances->count : count, record = 0;
    if (output->magic == MAGIC) rtcReleaseScene(output->accel->scene); /* what was there before */
    *output = (Mark){MAGIC, accel};
    accel->scene = rtcNewScene(device);
    rtcSetSceneFlags(accel->scene, 4); /* robust: no ray between two triangles */
    if (instances) {
        if (instances->instances % 16) fail("misaligned instances at %lx", instances->instances);
        accel->instances = malloc(n * sizeof(Instance) + 1);
        memcpy(accel->instances, (void *)instances->instances, n * sizeof(Instance));
    } else {
        accel->shapes = calloc(n + 1, sizeof(Shape));
    }
    for (u32 k = 0; k < n; k++) {
        void *geometry = instances ? instance_of(&accel->instances[k], device)
                                   : geometry_of(&inputs[k], device, &accel->shapes[k], &record);
        rtcCommitGeometry(geometry);
        rtcAttachGeometry(accel->scene, geometry);
        rtcReleaseGeometry(geometry);
    }
    rtcCommitScene(accel->scene);
    if (n_emitted) **(size_t **)emitted = sizeof(Mark) + 256; /* its compacted size */
    return 0;
}

static Result compact(void *context, void *stream, Accel *accel, Mark *output, size_t size, Accel **result) {
    *output = (Mark){MAGIC, accel};
    *result = accel;
    return 0;
}

static Result memory_of(void *context, void *options, void *inputs, u32 count, size_t *sizes) {
    sizes[0] = sizes[1] = sizes[2] = 4096; /* Embree takes its own */
    return 0;
}

/* ---- Modules, programs and launches. */

static Result create_module(void *context, void *options, void *pipeline, const char *ptx, size_t size, char *log, size_t *n_log,
                            Module **result, void **task) {
    *result = calloc(1, sizeof **result);
    /* Mitsuba's own programs meet shapes and end rays: Embree does that here. */
    if (strstr(ptx, "__raygen__")) (*result)->library = translated(ptx, size);
    return 0;
}
static Result create_module_with_tasks(void *context, void *options, void *pipeline, const char *ptx, size_t size, char *log,
                                       size_t *n_log, Module **result, void **task) {
    *task = NULL;
    return create_module(context, options, pipeline, ptx, size, log, n_log, result, NULL);
}
static Result state_of_module(Module *module, int *state) { *state = 0x2364; return 0; } /* compiled */
static Result run_task(void *task, void **others, u32 limit, u32 *count) { *count = 0; return 0; }

typedef struct { int kind; u32 flags; struct { Module *module; const char *name; } programs[3]; } ProgramDescription;

static Result create_programs(void *context, const ProgramDescription *given, u32 count, void *options, char *log, size_t *n_log,
                              Program **result) {
    for (u32 k = 0; k < count; k++) {
        Program *program = result[k] = calloc(1, sizeof *program);
        if (given[k].kind == 0x2424 && given[k].programs[2].name) program->intersection = strdup(given[k].programs[2].name);
        /* The second program of callables is a continuation callable. */
        for (int i = 0; i < (given[k].kind == 0x2421 ? 1 : given[k].kind == 0x2425 ? 2 : 0); i++)
            if (given[k].programs[i].module && !(program->entry = (Entry *)dlsym(given[k].programs[i].module->library, given[k].programs[i].name)))
                fail("no program %s", given[k].programs[i].name);
    }
    return 0;
}
static Result stack_of_program(Program *program, u32 *sizes, void *pipeline) { memset(sizes, 0, 28); return 0; }
static Result pack_header(Program *program, Program **record) { *record = program; return 0; }

static void trace(Lane *lane, u64 scene, const f32 *ray, u32 mask, u32 offset, u32 stride) {
    Query query = {0, NULL, ~0u, lane, (const Accel *)scene, offset, stride};
    RayHit hit = {{ray[0], ray[1], ray[2]}, ray[6], {ray[3], ray[4], ray[5]}, 0, ray[7], mask};
    hit.geometry = hit.instance = ~0u;
    memset(&lane->hit, 0, sizeof lane->hit);
    if (!scene) return;
    rtcIntersect1(query.accel->scene, &query, &hit);
    if (hit.geometry == ~0u) return;
    u64 data = record_of(&query, hit.instance, hit.geometry) + RECORD_HEADER;
    u32 id = query.accel->instances ? query.accel->instances[hit.instance].id : 0;
    lane->hit = (HitObject){1, id, hit.primitive, {0, 0}, hit.far, data};
    memcpy(lane->hit.attributes, &hit.u, 8);
}

static void *callable(Lane *lane, u32 index) {
    const Table *table = lane->table;
    return (void *)MEMORY(Program *, table->callable + (u64)within(lane, index, table->n_callables) * table->callable_stride)->entry;
}

static Result launch(void *pipeline, void *stream, const u8 *params, size_t size, const Table *table, u32 width, u32 height, u32 depth) {
    Lane lane = {.params = params, .table = table, .trace = trace, .callable = callable};
    run_lanes(MEMORY(Program *, table->raygen)->entry, lane, width * height * depth);
    return 0;
}

static Result nothing(void) { return 0; }
static Result create_context(void *cuda, void *options, void **result) { static char it; *result = &it; return 0; }
static Result create_builtin(void *context, void *options, void *pipeline, void *kind, Module **result) {
    *result = calloc(1, sizeof **result);
    return 0;
}
static Result create_pipeline(void *context, void *options, void *link, void *programs, u32 count, char *log, size_t *n_log,
                              void **result) {
    return create_context(NULL, NULL, result);
}

EXPORT Result optixQueryFunctionTable(int abi, u32 n_options, void *options, void **values, void **table, size_t size) {
    /* OptixFunctionTable of ABI 105: its order is that of optix_function_table.h. */
    static void *const functions[48] = {
        [2] = create_context, [12] = create_module, [13] = create_module_with_tasks, [14] = state_of_module,
        [16] = create_builtin, [17] = run_task, [18] = create_programs, [20] = stack_of_program, [21] = create_pipeline,
        [24] = memory_of, [25] = build, [29] = compact, [40] = pack_header, [41] = launch,
    };
    for (size_t k = 0; k < size / sizeof *table; k++) table[k] = k < 48 && functions[k] ? functions[k] : (void *)nothing;
    return 0;
}
