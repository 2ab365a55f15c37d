// Times Embree 3 on the rays that `tests/benches/ray.rs` writes: robust scene, one ray at a time, one thread.
// See README.md beside this file.
#include <embree3/rtcore.h>

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <string>
#include <vector>

struct RaySet {
    std::string name;
    bool shadow;
    std::vector<float> rays;  // origin, direction, t_max
};

static void read_exactly(FILE *file, void *to, size_t bytes) {
    if (fread(to, 1, bytes, file) != bytes) {
        fprintf(stderr, "the file ends early\n");
        exit(1);
    }
}

static uint64_t read_count(FILE *file) {
    uint64_t count;
    read_exactly(file, &count, sizeof count);
    return count;
}

// CPU seconds of this thread, so that other work on the machine does not count.
static double cpu_seconds() {
    timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return now.tv_sec + 1e-9 * now.tv_nsec;
}

static size_t trace(RTCScene scene, const RaySet &set) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    size_t hits = 0;
    for (size_t i = 0; i < set.rays.size(); i += 7) {
        const float *r = &set.rays[i];
        RTCRayHit query = {};
        RTCRay &ray = query.ray;
        ray.org_x = r[0], ray.org_y = r[1], ray.org_z = r[2];
        ray.dir_x = r[3], ray.dir_y = r[4], ray.dir_z = r[5];
        ray.tnear = 0, ray.tfar = r[6], ray.mask = ~0u;
        if (set.shadow) {
            rtcOccluded1(scene, &context, &ray);
            hits += ray.tfar < 0;
        } else {
            query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
            rtcIntersect1(scene, &context, &query);
            hits += query.hit.geomID != RTC_INVALID_GEOMETRY_ID;
        }
    }
    return hits;
}

int main(int argc, char **argv) {
    if (argc < 3) {
        fprintf(stderr, "usage: embree_rays NAME FILE.rays [fast]\n");
        return 2;
    }
    FILE *file = fopen(argv[2], "rb");
    if (!file) {
        perror(argv[2]);
        return 1;
    }
    uint64_t triangles = read_count(file);
    RTCDevice device = rtcNewDevice("threads=1,set_affinity=0");
    RTCScene scene = rtcNewScene(device);
    if (argc < 4) rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    void *vertices =
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, 3 * triangles);
    auto *indices = static_cast<uint32_t *>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, triangles));
    read_exactly(file, vertices, 36 * triangles);
    for (uint64_t i = 0; i < 3 * triangles; i++) indices[i] = i;
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    double start = cpu_seconds();
    rtcCommitScene(scene);
    printf("%s build %.3f %llu\n", argv[1], triangles / (cpu_seconds() - start) * 1e-6, (unsigned long long)triangles);

    std::vector<RaySet> sets(read_count(file));
    for (RaySet &set : sets) {
        char name[17] = {};
        read_exactly(file, name, 16);
        for (char *c = name; *c; c++) *c = *c == ' ' ? '_' : *c;
        set.name = name;
        set.shadow = read_count(file) != 0;
        set.rays.resize(7 * read_count(file));
        read_exactly(file, set.rays.data(), 4 * set.rays.size());
        double best = INFINITY;
        size_t hits = 0;
        for (int run = 0; run < 7; run++) {
            start = cpu_seconds();
            hits = trace(scene, set);
            best = std::fmin(best, (cpu_seconds() - start));
        }
        printf("%s %s %.3f %zu\n", argv[1], name, set.rays.size() / 7 / best * 1e-6, hits);
    }
    fclose(file);
    rtcReleaseGeometry(geometry);
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
}
