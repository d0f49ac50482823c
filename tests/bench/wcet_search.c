/* Tables that flight accepts, changed at random, and how many instructions the steps of a calibration take with them:
 * what tests/bench/wcet_search.py searches the worst of.
 *
 * Input: a set of tables a line, as the seeds of the changes that lead to it from the largest tables
 * (given_largest.c). Output: for each of its steps a line with number of the set, state after the step and
 * instructions, or one with -1 if flight refuses a table. Instructions are estimated in the build `count`, which calls
 * __sanitizer_cov_trace_pc in every basic block; in others they are 0, and valgrind counts.
 *
 * A change sets one field of a table, or the same field of all its entries. Which fields there are and in which limits
 * is what the layout walks over (kc_layout.c); the linker puts the functions below before those of the walk. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "given_largest.h"
#include "given_tables.h"
#include "given_world.h"
#include "kc_codec.h"
#include "kc_layout.h"
#include "kc_libm.h"
#include "kc_rng.h"

#define APP (&kc_app_instance)
#define N_BEFORE (KC_MEAS_MAX - 1u)
#define STEPS_MAX 400u
#define IDLE_POSTURES 3u
#define LINE_MAX 4096u

/* ---- instructions ---- */

extern const char __executable_start[];
static uint8_t *s_weight; /* instructions after the call in a block, by address of the program */
static size_t s_weights;
static uint64_t s_count, s_step;

void __sanitizer_cov_trace_pc(void);
__attribute__((no_sanitize_coverage)) void __sanitizer_cov_trace_pc(void)
{
    size_t at = (size_t)((const char *)__builtin_return_address(0) - __executable_start);
    s_count += at < s_weights ? s_weight[at] : 0u;
}

static void read_weights(const char *path)
{
    FILE *f = fopen(path, "rb");
    if (f == NULL) { return; }
    s_weight = malloc(1u << 24u);
    if (s_weight != NULL) { s_weights = fread(s_weight, 1u, 1u << 24u, f); }
    (void)fclose(f);
}

void __real_kc_app_step(kc_app_t *app, uint64_t now_us, const kc_in_t *in, kc_out_t *out);
void __wrap_kc_app_step(kc_app_t *app, uint64_t now_us, const kc_in_t *in, kc_out_t *out);
void __wrap_kc_app_step(kc_app_t *app, uint64_t now_us, const kc_in_t *in, kc_out_t *out)
{
    uint64_t before = s_count;
    __real_kc_app_step(app, now_us, in, out);
    s_step = s_count - before;
}

/* ---- one change ---- */

static struct {
    bool on;
    uint32_t n, at; /* fields seen, the one to change */
    uint32_t field; /* its number, when its turn has come or in all entries */
    bool all;
    uint64_t seed, rng;
} s_change;

/* Whether this visit is to be changed. All entries get the same value or each its own, as the seed has it. */
static bool changes(uint32_t field)
{
    if (!s_change.on) { return false; }
    uint32_t n = s_change.n++;
    if (s_change.at == n) { s_change.field = field; }
    if (s_change.at != n && !(s_change.all && s_change.field == field && n > s_change.at)) { return false; }
    if ((s_change.seed >> 40u & 1u) != 0u) { s_change.rng = s_change.seed; }
    return true;
}

static double real_between(double lo, double hi, double old)
{
    uint64_t *r = &s_change.rng;
    double u = kc_rng_uniform(r), x = old;
    switch (kc_rng_below(r, 6u)) {
    case 0u: x = u < 0.5 ? lo : hi; break;
    case 1u: x = lo + u * (hi - lo); break;
    case 2u: x = old * (0.5 + u); break;
    case 3u: x = 0.0; break;
    default: /* any size */
        x = kc_exp(36.0 * (u - 0.6));
        x = lo < 0.0 && kc_rng_below(r, 2u) == 0u ? -x : x;
        break;
    }
    return kc_clamp(x, lo, hi);
}

static uint64_t whole_between(uint64_t lo, uint64_t hi, uint64_t old)
{
    uint64_t *r = &s_change.rng, span = hi - lo;
    switch (kc_rng_below(r, 5u)) {
    case 0u: return lo;
    case 1u: return hi;
    case 2u: return old < hi ? old + 1u : old;
    default: return lo + (span == UINT64_MAX ? kc_rng_next(r) : kc_rng_next(r) % (span + 1u));
    }
}

#define WHOLE(NAME, type)                                                                           \
    void __real_kc_walk_##NAME(kc_walk_t *w, uint32_t field, type *v, type lo, type hi);            \
    void __wrap_kc_walk_##NAME(kc_walk_t *w, uint32_t field, type *v, type lo, type hi);            \
    void __wrap_kc_walk_##NAME(kc_walk_t *w, uint32_t field, type *v, type lo, type hi)             \
    {                                                                                               \
        if (changes(field)) { *v = (type)whole_between((uint64_t)lo, (uint64_t)hi, (uint64_t)*v); } \
        __real_kc_walk_##NAME(w, field, v, lo, hi);                                                 \
    }
WHOLE(u8, uint8_t)
WHOLE(u16, uint16_t)
WHOLE(u32, uint32_t)
WHOLE(u64, uint64_t)

#define REAL(NAME, type)                                                                     \
    void __real_kc_walk_##NAME(kc_walk_t *w, uint32_t field, type *v, double lo, double hi); \
    void __wrap_kc_walk_##NAME(kc_walk_t *w, uint32_t field, type *v, double lo, double hi); \
    void __wrap_kc_walk_##NAME(kc_walk_t *w, uint32_t field, type *v, double lo, double hi)  \
    {                                                                                        \
        if (changes(field)) { *v = (type)real_between(lo, hi, (double)*v); }                 \
        __real_kc_walk_##NAME(w, field, v, lo, hi);                                          \
    }
REAL(f64, double)
REAL(f32, float)

void __real_kc_walk_vec(kc_walk_t *w, uint32_t field, double *v, uint32_t n, double lo, double hi);
void __wrap_kc_walk_vec(kc_walk_t *w, uint32_t field, double *v, uint32_t n, double lo, double hi);
void __wrap_kc_walk_vec(kc_walk_t *w, uint32_t field, double *v, uint32_t n, double lo, double hi)
{
    for (uint32_t i = 0u; i < n; i++) {
        if (changes(field)) { v[i] = real_between(lo, hi, v[i]); }
    }
    __real_kc_walk_vec(w, field, v, n, lo, hi);
}

static uint32_t walked(uint16_t kind, void *table)
{
    kc_walk_t w;
    memset(&w, 0, sizeof w);
    w.mode = KC_WALK_CHECK;
    s_change.n = 0u;
    s_change.on = true;
    kc_layout_walk(&w, kind, table);
    s_change.on = false;
    return s_change.n;
}

/* ---- what arrives and what was measured, as far as it is no table ---- */

static struct {
    double temp_c, payload_kg, g_m_s2, dir, miss_m, outlier_m;
} s_given;

static void change_given(void)
{
    struct {
        double *v, lo, hi;
    } field[] = {
        {&s_given.temp_c, -273.0, 1000.0}, {&s_given.payload_kg, 0.0, 1e4}, {&s_given.g_m_s2, -100.0, 100.0},
        {&s_given.dir, -1.0, 1.0},         {&s_given.miss_m, 0.0, 0.2},     {&s_given.outlier_m, 0.0, 3.0},
    };
    uint32_t i = kc_rng_below(&s_change.rng, (uint32_t)(sizeof field / sizeof field[0]));
    *field[i].v = real_between(field[i].lo, field[i].hi, *field[i].v);
}

static void spoil_in(kc_in_t *in)
{
    in->arm.temp_c = s_given.temp_c;
    in->arm.payload_kg = s_given.payload_kg;
    in->arm.g_m_s2[2] = s_given.g_m_s2;
}

/* ---- a set of tables ---- */

static void change(uint64_t seed)
{
    static const struct {
        uint16_t kind;
        uint16_t share; /* of 16 */
    } of[] = {{KC_TBL_TERMS, 5u},
              {KC_TBL_CONFIG, 4u},
              {KC_TBL_SPACE, 2u},
              {KC_TBL_ARM, 2u},
              {KC_TBL_KERNEL, 1u},
              {KC_TBL_CAMERA, 1u},
              {0u, 1u}};
    static kc_tbl_scratch_t before, decoded;
    s_change.seed = s_change.rng = kc_rng_next(&seed);
    uint32_t pick = kc_rng_below(&s_change.rng, 16u), k = 0u;
    while (pick >= of[k].share) { pick -= of[k++].share; }
    uint16_t kind = of[k].kind;
    void *table[KC_TBL_COUNT] = {NULL, &world.arm,   &world.camera, &world.terms,
                                 NULL, &world.space, &world.kernel, &world.config};
    if (kind == 0u) {
        change_given();
        return;
    }
    memcpy(&before, table[kind], kc_layout_struct_bytes(kind));
    s_change.all = kc_rng_below(&s_change.rng, 2u) == 0u;
    s_change.at = UINT32_MAX;
    s_change.at = kc_rng_below(&s_change.rng, walked(kind, table[kind]));
    (void)walked(kind, table[kind]);
    kc_events_t ev = {0};
    uint32_t n = given_image(kind, table[kind], world.image);
    if (kc_tbl_decode(kind, world.image, n, &decoded, &ev) != KC_OK) {
        memcpy(table[kind], &before, kc_layout_struct_bytes(kind));
    }
}

static bool accepted(void)
{
    for (uint16_t kind = KC_TBL_ARM; kind < KC_TBL_COUNT; kind++) {
        if (kc_app_active(APP)->crc[kind] == 0u) { return false; }
    }
    return true;
}

static uint32_t s_set;

static void tick(void)
{
    world_tick();
    (void)printf("%u %d %llu\n", (unsigned)s_set, (int)kc_app_state(APP), (unsigned long long)s_step);
}

static void ticks(uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) { tick(); }
}

/* Detections while idle, as many as a step takes, for the monitor. */
static void idle(void)
{
    world.frames_at_once = KC_DET_QUEUE_MAX;
    for (uint32_t i = 0u; i < IDLE_POSTURES; i++) {
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
            world.q_cmd[j] = world.q[j] = 0.3 + 0.17 * (double)((3u * i + 5u * j) % 7u);
        }
        world.requested = true;
        ticks(3u);
    }
    world.frames_at_once = 0u;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { world.q_cmd[j] = world.q[j] = 0.0; }
}

static void measured_before(void)
{
    given_poses(N_BEFORE);
    for (uint32_t i = 0u; i < APP->est.n_obs; i++) {
        kc_obs_t *o = &APP->est.obs[i];
        o->ctx.temp_c = s_given.temp_c;
        o->ctx.payload_kg = s_given.payload_kg;
        o->ctx.g_m_s2[2] = s_given.g_m_s2;
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { o->ctx.dir[j] = s_given.dir; }
        for (uint32_t k = 0u; k < 3u; k++) {
            double off = i % 8u == 0u ? s_given.outlier_m / (double)(1u + i) : s_given.miss_m;
            o->p_m[k] += off * (2.0 * kc_rng_uniform(&world.rng) - 1.0);
        }
    }
}

static void calibrate(void)
{
    (void)world_cmd(KC_CMD_START, -1, 0, 3);
    tick();
    if (!world_calibrating()) { return; }
    measured_before();
    for (uint32_t i = 0u; i < STEPS_MAX && world_calibrating(); i++) { tick(); }
}

static void run(char *seeds)
{
    given_largest(KC_ACQ_DOPT);
    world.config.n_poses = KC_MEAS_MAX;
    world.config.est.iter_max = 3u;
    world.spoil_in = spoil_in;
    s_given.temp_c = 20.0;
    s_given.payload_kg = s_given.dir = s_given.miss_m = s_given.outlier_m = 0.0;
    s_given.g_m_s2 = -9.81;
    for (char *at = seeds, *end; *at != '\0' && *at != '\n'; at = end) {
        unsigned long long seed = strtoull(at, &end, 10);
        if (end == at) { break; }
        change(seed);
    }
    world_boot();
    if (!accepted()) {
        (void)printf("%u -1 0\n", (unsigned)s_set);
        return;
    }
    tick();
    idle();
    calibrate();
}

int main(int argc, char **argv)
{
    static char line[LINE_MAX];
    if (argc > 1) { read_weights(argv[1]); }
    for (s_set = 0u; fgets(line, sizeof line, stdin) != NULL; s_set++) { run(line); }
    return 0;
}
