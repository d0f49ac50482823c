#include "kc_suspects.h"

#include <string.h>

#include "kc_chi2.h"
#include "kc_la.h"
#include "kc_libm.h"
#include "kc_rot.h"
#include "kc_vec.h"

#define TOGETHER 2u     /* joints of a set at most */
#define STEPS_ONE 5u    /* Gauss-Newton steps: of one bias from 0, ... */
#define STEPS_TWO 4u    /* ... of two from where the better one alone ended */
#define STEP_SMALL 1e-9 /* [rad or m] */
#define SETS (KC_JOINT_MAX * (KC_JOINT_MAX + 1u) / 2u)
#define DEPENDENT 1e-6 /* part of its information that a joint keeps beside another that does the same */

/* A set of joints and its best biases. Gradient, information, and the gradient's variance as in kc_monitor.c. */
typedef struct {
    uint32_t n, joint[TOGETHER]; /* from the tool to the base: a turn moves the axis of no later one */
    double bias[TOGETHER], grad[TOGETHER], var[TOGETHER];
    double info[TOGETHER][TOGETHER];
    double rest; /* chi-square that remains */
} set_t;

/* What the biases of a set do to the tool. */
typedef struct {
    double a[TOGETHER][6]; /* derivative of its pose by each of them */
    double d[3], R[9]; /* shift and turn */
} moved_t;

/* The next joint, joint j at place i, moves the tool by a bias, after the places before it did. Its row c is (z x
 * (p - o); z), or (axis; 0), where the tool was at first. */
static void move(const kc_monitor_t *m, const double c[6], const set_t *f, uint32_t i, moved_t *t)
{
    const double *z = c + 3, bias = f->bias[i];
    double v[3], zv[3], w[3], turn[9], s = kc_sin(bias), h = kc_sin(0.5 * bias);
    memcpy(t->a[i], c, 6u * sizeof(double));
    if ((m->prismatic >> f->joint[i] & 1u) != 0u) {
        kc_v3_add_scaled(t->d, bias, c, t->d);
        return;
    }
    kc_v3_cross(z, t->d, v);
    kc_v3_add_scaled(v, 1.0, c, v);
    kc_v3_cross(z, v, zv);
    for (uint32_t k = 0u; k < 3u; k++) {
        t->d[k] += s * v[k] + 2.0 * h * h * zv[k];
        t->a[i][k] = kc_cos(bias) * v[k] + s * zv[k];
        w[k] = bias * z[k];
    }
    kc_R_exp(w, turn);
    for (uint32_t b = 0u; b < i; b++) {
        double u[6];
        kc_m3_mul_v3(turn, t->a[b], u);
        kc_m3_mul_v3(turn, t->a[b] + 3, u + 3);
        memcpy(t->a[b], u, sizeof u);
    }
    double R[9];
    kc_m3_mul(turn, t->R, R);
    memcpy(t->R, R, sizeof R);
}

/* Residual of observation k if the joints of the set stand their biases beyond their readings, and how the tool
 * moves. */
static void residual(const kc_monitor_t *m, const kc_mon_obs_t *k, const set_t *f, double r[6], moved_t *t)
{
    double seen[9], back[9], left[9];
    memset(t, 0, sizeof *t);
    for (uint32_t i = 0u; i < 3u; i++) { t->R[4u * i] = 1.0; }
    for (uint32_t i = 0u; i < f->n; i++) { move(m, k->Jq[f->joint[i]], f, i, t); }
    for (uint32_t i = 0u; i < 3u; i++) {
        r[i] = k->r[i] - t->d[i];
        for (uint32_t c = 0u; c < 3u; c++) { back[3u * i + c] = t->R[3u * c + i]; }
    }
    kc_R_exp(k->r + 3, seen);
    kc_m3_mul(seen, back, left);
    kc_R_log(left, r + 3);
}

/* How strongly an error of the floor's size in the worst direction pulls at the bias whose whitened derivative is a,
 * squared. */
static double pull2(const kc_monitor_t *m, const kc_mon_obs_t *k, const double a[6])
{
    double s2 = 0.0;
    for (uint32_t c = 0u; c < 6u; c++) {
        double u = 0.0;
        for (uint32_t b = c; b < 6u; b++) { u += k->W[6u * b + c] * a[b]; }
        s2 += u * u * m->floor2[c];
    }
    return s2;
}

/* Sums over the newest n observations at the set's biases. */
static void sums(const kc_monitor_t *m, uint32_t n, set_t *f)
{
    double shared[TOGETHER] = {0.0, 0.0}, shared2[TOGETHER] = {0.0, 0.0};
    f->rest = 0.0;
    memset(f->grad, 0, sizeof f->grad);
    memset(f->info, 0, sizeof f->info);
    for (uint32_t o = 0u; o < n; o++) {
        const kc_mon_obs_t *k = kc_monitor_back(m, o);
        moved_t t;
        double r[6];
        residual(m, k, f, r, &t);
        kc_la_whiten_apply(k->W, r, r);
        f->rest += kc_v_dot(r, r, 6u);
        for (uint32_t i = 0u; i < f->n; i++) {
            kc_la_whiten_apply(k->W, t.a[i], t.a[i]);
            f->grad[i] += kc_v_dot(t.a[i], r, 6u);
            for (uint32_t b = 0u; b <= i; b++) { f->info[i][b] += kc_v_dot(t.a[i], t.a[b], 6u); }
            double s2 = pull2(m, k, t.a[i]);
            shared[i] += kc_sqrt(s2);
            shared2[i] += s2;
        }
    }
    for (uint32_t i = 0u; i < f->n; i++) { f->var[i] = f->info[i][i] + shared[i] * shared[i] - shared2[i]; }
}

/* Part of its information that the set's first joint keeps if the biases of all are unknown; both keep the same. */
static double kept(const set_t *f)
{
    if (f->n < TOGETHER) { return 1.0; }
    double both = f->info[0][0] * f->info[1][1];
    return both > 0.0 ? 1.0 - f->info[1][0] * f->info[1][0] / both : 0.0;
}

/* Whether the observations tell the biases of the set. */
static bool tells(const set_t *f) { return f->info[0][0] > 0.0 && kept(f) > DEPENDENT; }

/* One Gauss-Newton step; its largest part. */
static double step(set_t *f)
{
    double x[TOGETHER], largest = 0.0;
    x[0] = f->grad[0] / f->info[0][0];
    x[1] = 0.0;
    if (f->n == TOGETHER) {
        double det = f->info[0][0] * f->info[1][1] * kept(f);
        x[0] = (f->info[1][1] * f->grad[0] - f->info[1][0] * f->grad[1]) / det;
        x[1] = (f->info[0][0] * f->grad[1] - f->info[1][0] * f->grad[0]) / det;
    }
    for (uint32_t i = 0u; i < TOGETHER && i < f->n; i++) {
        f->bias[i] = kc_clamp(f->bias[i] + x[i], -KC_SUSPECT_BIAS, KC_SUSPECT_BIAS);
        largest = kc_max(largest, kc_fabs(x[i]));
    }
    return largest;
}

/* The best biases of a set, from those in it. False: the observations do not tell them. */
static bool fit(const kc_monitor_t *m, uint32_t n, uint32_t steps, set_t *best)
{
    set_t f = *best;
    sums(m, n, &f);
    *best = f;
    for (uint32_t i = 0u; i < steps && tells(&f); i++) {
        double largest = step(&f);
        sums(m, n, &f);
        if (f.rest <= best->rest) { *best = f; }
        if (largest < STEP_SMALL) { break; }
    }
    return tells(best);
}

/* By how much differences of chi-square count, since errors that all observations share may lie behind them. */
static double trust(const set_t *f)
{
    double t = 1.0;
    for (uint32_t i = 0u; i < f->n; i++) { t = kc_min(t, f->info[i][i] / f->var[i]); }
    return t;
}

/* Logarithm of the weight but for a constant. */
static double log_weight(const set_t *f, double trusted)
{
    const double volume = 0.5 * kc_log(2.0 * KC_PI) -
                          kc_log(2.0 * KC_SUSPECT_BIAS); /* of a bias, at information 1 */
    double w = -0.5 * trusted * f->rest + (double)(f->n - 1u) * kc_log(KC_SUSPECT_ODDS) -
               0.5 * kc_log(kept(f));
    for (uint32_t i = 0u; i < f->n; i++) { w += volume - 0.5 * kc_log(trusted * f->info[i][i]); }
    return w;
}

/* Single joints, then pairs. Only those that tell their biases and leave noise; how many. */
static uint32_t explain(const kc_monitor_t *m, uint32_t n, set_t *set)
{
    set_t one[KC_JOINT_MAX];
    uint32_t count = 0u;
    for (uint32_t j = 0u; j < m->n_joints; j++) {
        one[j] = (set_t){.n = 1u, .joint = {j, 0u}};
        bool known = fit(m, n, STEPS_ONE, &one[j]);
        if (known && kc_chi2_sf(one[j].rest, 6u * n - 1u) >= KC_MON_P_REST) { set[count++] = one[j]; }
        for (uint32_t i = 0u; i < j; i++) {
            set_t two = {.n = TOGETHER, .joint = {j, i}};
            if (one[j].rest <= one[i].rest) {
                two.bias[0] = one[j].bias[0];
            } else {
                two.bias[1] = one[i].bias[0];
            }
            known = fit(m, n, STEPS_TWO, &two);
            if (known && kc_chi2_sf(two.rest, 6u * n - TOGETHER) >= KC_MON_P_REST) { set[count++] = two; }
        }
    }
    return count;
}

/* The most probable set. */
static void name(const set_t *f, uint32_t n, kc_suspects_t *s)
{
    for (uint32_t i = 0u; i < f->n; i++) {
        uint32_t j = f->joint[i];
        s->joints |= 1u << j;
        s->bias[j] = f->bias[i];
        s->sigma[j] = kc_sqrt(f->var[i] / kept(f)) / f->info[i][i];
    }
    s->p_rest = kc_chi2_sf(f->rest, 6u * n - f->n);
}

void kc_suspects_weigh(const kc_monitor_t *m, uint32_t n_obs, kc_suspects_t *s)
{
    set_t set[SETS];
    double weight[SETS], trusted = 1.0, sum = 0.0;
    uint32_t n = n_obs < m->n ? n_obs : m->n, best = 0u;
    memset(s, 0, sizeof *s);
    s->n_obs = n < KC_SUSPECT_OBS ? n : KC_SUSPECT_OBS;
    uint32_t count = s->n_obs < KC_MON_OBS_MIN ? 0u : explain(m, s->n_obs, set);
    for (uint32_t i = 0u; i < count; i++) { trusted = kc_min(trusted, trust(&set[i])); }
    for (uint32_t i = 0u; i < count; i++) {
        weight[i] = log_weight(&set[i], trusted);
        if (weight[i] > weight[best]) { best = i; }
    }
    for (uint32_t i = 0u; i < count; i++) { sum += kc_exp(weight[i] - weight[best]); }
    for (uint32_t i = 0u; i < count; i++) {
        double part = kc_exp(weight[i] - weight[best]) / sum;
        for (uint32_t k = 0u; k < set[i].n; k++) { s->chance[set[i].joint[k]] += part; }
    }
    for (uint32_t j = 0u; j < m->n_joints; j++) {
        if (s->chance[j] >= KC_SUSPECT_MIN) { s->suspects |= 1u << j; }
    }
    if (count > 0u) { name(&set[best], s->n_obs, s); }
}

uint64_t kc_suspects_cost(const kc_monitor_t *m)
{
    const uint64_t n = m->n < KC_SUSPECT_OBS ? m->n : KC_SUSPECT_OBS, joints = m->n_joints;
    const uint64_t sums_one = STEPS_ONE + 1u, sums_two = STEPS_TWO + 1u, sets = SETS;
    const uint64_t one = 3000u * sums_one, two = 6500u * sums_two;
    return n * joints * (one + (joints - 1u) / 2u * two + two / 2u) + 12000u * sets;
}
