/* How near the limit: what a compiled loop takes for the work that no renderer can leave out.

   find() is the plain ray tracer, every ray against every object: what is seen in each pixel,
   and which lights reach it.  shade() is told that, and only computes the visible hit and its
   shading: no search, no shadow ray.  Its time is a floor for any tracer of this model in
   float64 on one thread.  */

#include <math.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    double eye[3], corner[3], right[3], down[3]; /* rays: corner + x right + y down */
    ptrdiff_t width, height, spheres, boxes, lights;
    const double *sphere;   /* centre, radius */
    const double *box;      /* minimum, maximum */
    const double *light;    /* position, intensity */
    const double *material; /* of each object: diffuse, specular, exponent */
} Scene;

static double dot(const double *a, const double *b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* The near t of a ray o + t d with an object, or infinity; eyes are outside. */
static double hit(const Scene *s, ptrdiff_t k, const double *o, const double *d, int *axis) {
    if (k < s->spheres) {
        const double *c = s->sphere + 4 * k;
        double m[3] = {c[0] - o[0], c[1] - o[1], c[2] - o[2]};
        double a = dot(d, d), t = dot(m, d) / a;
        double h[3] = {m[0] - t * d[0], m[1] - t * d[1], m[2] - t * d[2]};
        double half2 = (c[3] * c[3] - dot(h, h)) / a;
        return half2 > 0 && t > 0 ? t - sqrt(half2) : INFINITY;
    }
    const double *b = s->box + 6 * (k - s->spheres);
    double enter = -INFINITY, leave = INFINITY;
    for (int i = 0; i < 3; i++) {
        double t0 = (b[i] - o[i]) / d[i], t1 = (b[i + 3] - o[i]) / d[i];
        double near = t0 < t1 ? t0 : t1, far = t0 < t1 ? t1 : t0;
        if (near > enter) enter = near, *axis = i;
        if (far < leave) leave = far;
    }
    return enter <= leave && enter > 0 ? enter : INFINITY;
}

static void ray(const Scene *s, ptrdiff_t pixel, double *d) {
    double x = pixel % s->width + .5, y = pixel / s->width + .5;
    for (int i = 0; i < 3; i++) d[i] = s->corner[i] + x * s->right[i] + y * s->down[i];
}

static void point(const Scene *s, ptrdiff_t k, const double *d, double t, int axis, double *p,
                  double *n) {
    for (int i = 0; i < 3; i++) p[i] = s->eye[i] + t * d[i];
    for (int i = 0; i < 3; i++)
        n[i] = k < s->spheres ? (p[i] - s->sphere[4 * k + i]) / s->sphere[4 * k + 3]
                              : (i == axis) * (d[i] < 0 ? 1. : -1.);
}

/* owner: the object seen in each pixel, or -1; lit: a bit for each light that reaches it. */
void find(const Scene *s, int32_t *owner, uint64_t *lit) {
    ptrdiff_t objects = s->spheres + s->boxes;
    for (ptrdiff_t pixel = 0; pixel < s->width * s->height; pixel++) {
        double d[3], p[3], n[3], nearest = INFINITY;
        int axis = 0, its = 0;
        owner[pixel] = -1, lit[pixel] = 0;
        ray(s, pixel, d);
        for (ptrdiff_t k = 0; k < objects; k++) {
            double t = hit(s, k, s->eye, d, &axis);
            if (t < nearest) nearest = t, owner[pixel] = k, its = axis;
        }
        if (owner[pixel] < 0) continue;
        point(s, owner[pixel], d, nearest, its, p, n);
        for (ptrdiff_t j = 0; j < s->lights; j++) {
            const double *q = s->light + 6 * j;
            double l[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
            int free = dot(n, l) > 0;
            for (ptrdiff_t k = 0; free && k < objects; k++)
                free = k == owner[pixel] || !(hit(s, k, p, l, &axis) < 1);
            lit[pixel] |= (uint64_t)free << j;
        }
    }
}

void shade(const Scene *s, const int32_t *owner, const uint64_t *lit, double *image) {
    for (ptrdiff_t pixel = 0; pixel < s->width * s->height; pixel++) {
        double d[3], p[3], n[3], *out = image + 3 * pixel;
        int axis = 0;
        ptrdiff_t k = owner[pixel];
        out[0] = out[1] = out[2] = 0;
        if (k < 0) continue;
        ray(s, pixel, d);
        double t = hit(s, k, s->eye, d, &axis), length = sqrt(dot(d, d));
        point(s, k, d, t, axis, p, n);
        const double *m = s->material + 7 * k;
        for (ptrdiff_t j = 0; j < s->lights; j++) {
            if (!(lit[pixel] >> j & 1)) continue;
            const double *q = s->light + 6 * j;
            double l[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
            double away = sqrt(dot(l, l)), cosine = dot(n, l) / away, lobe = 0;
            if (m[3] + m[4] + m[5] > 0) {
                double h[3];
                for (int i = 0; i < 3; i++) h[i] = l[i] / away - d[i] / length;
                lobe = pow(dot(n, h) / sqrt(dot(h, h)), m[6]);
            }
            for (int i = 0; i < 3; i++) out[i] += q[3 + i] * (m[i] * cosine + m[3 + i] * lobe);
        }
    }
}
