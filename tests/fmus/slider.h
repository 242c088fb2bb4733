/* A slider on a spring and a damper, pushed by a force, with an elastic end stop; after the FMI
   standard's text, with nothing of pamid in it.

   states    position (m), speed (m/s)
   event     the stop is met or left: touching, a discrete state, changes in event mode alone
   SAMPLED   the force passes a hold of 0.05 s: a discrete state, changed by time events
   FAULT     what goes wrong once 0.5 s have passed: CRASH, HANG, REFUSE (an error), NONSENSE (NaN) */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

enum { NONE, CRASH, HANG, REFUSE, NONSENSE };
#ifndef FAULT
#define FAULT NONE
#endif
#define HOLD_S 0.05
#define OWN_STEP_S 0.0005
#define STOP_DAMPING 20.0

enum { TIME, FORCE, POSITION, SPEED, DER_POSITION, DER_SPEED, MASS, STIFFNESS, DAMPING, STOP,
       STOP_STIFFNESS, HELD, COUNT };

typedef struct {
    double v[COUNT];
    int touching;
    long events;        /* time events that have been */
    int exchange;       /* instantiated for model exchange */
    char *token;
} Slider;

static void start(Slider *s)
{
    memset(s->v, 0, sizeof s->v);
    s->v[MASS] = 2.0;
    s->v[STIFFNESS] = 80.0;
    s->v[DAMPING] = 3.0;
    s->v[STOP] = 0.12;
    s->v[STOP_STIFFNESS] = 4000.0;
    s->touching = 0;
    s->events = 0;
}

static double push(const Slider *s)
{
#ifdef SAMPLED
    return s->v[HELD];
#else
    return s->v[FORCE];
#endif
}

/* d(speed)/dt and what it is made of */
static void rates(Slider *s)
{
    double *v = s->v;
    double f = push(s) - v[STIFFNESS] * v[POSITION] - v[DAMPING] * v[SPEED];
    if (s->touching)
        f -= v[STOP_STIFFNESS] * (v[POSITION] - v[STOP]) + STOP_DAMPING * v[SPEED];
    v[DER_POSITION] = v[SPEED];
    v[DER_SPEED] = f / v[MASS];
}

static double indicator(const Slider *s)
{
    return s->v[POSITION] - s->v[STOP];
}

#ifdef SAMPLED
static double next_event(const Slider *s)
{
    return (double)(s->events + 1) * HOLD_S;
}
#endif

/* an event iteration; whether a discrete state has changed */
static int discrete(Slider *s)
{
    int touching = indicator(s) > 0.0, changed = touching != s->touching;
    s->touching = touching;
#ifdef SAMPLED
    if (s->v[TIME] >= next_event(s) - 1e-9 || (s->events == 0 && s->v[TIME] <= 0.0)) {
        while (s->v[TIME] >= next_event(s) - 1e-9)
            s->events++;
        changed |= s->v[HELD] != s->v[FORCE];
        s->v[HELD] = s->v[FORCE];
    }
#endif
    return changed;
}

/* what goes wrong; 1 where the caller is to return an error */
static int fault(Slider *s)
{
    volatile double *nowhere = NULL;
    volatile int forever = 1;
    if (FAULT == NONE || s->v[TIME] < 0.5)
        return 0;
    if (FAULT == CRASH)
        *nowhere = 1.0;
    while (FAULT == HANG && forever)
        ;
    if (FAULT == NONSENSE)
        s->v[SPEED] = NAN;
    return FAULT == REFUSE;
}

/* co-simulation: RK4 of its own; events are looked at before every own step */
static int advance(Slider *s, double h)
{
    int n = (int)ceil(h / OWN_STEP_S - 1e-9), i, k;
    double dt = h / n, from = s->v[TIME];
    const double part[3] = {0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    for (i = 0; i < n; i++) {
        double x, w, dx = 0.0, dw = 0.0;
        discrete(s);
        x = s->v[POSITION];
        w = s->v[SPEED];
        for (k = 0; k < 4; k++) {
            rates(s);
            dx += weight[k] * s->v[DER_POSITION] / 6.0;
            dw += weight[k] * s->v[DER_SPEED] / 6.0;
            if (k < 3) {
                s->v[POSITION] = x + part[k] * dt * s->v[DER_POSITION];
                s->v[SPEED] = w + part[k] * dt * s->v[DER_SPEED];
            }
        }
        s->v[POSITION] = x + dt * dx;
        s->v[SPEED] = w + dt * dw;
        s->v[TIME] = from + (i + 1) * dt;
    }
    return fault(s);
}

/* d unknown / d known, 0 where there is no such dependence */
static double partial(const Slider *s, unsigned unknown, unsigned known)
{
    const double *v = s->v;
    if (unknown == known)
        return 1.0;
    if (unknown == DER_POSITION)
        return known == SPEED;
    if (unknown != DER_SPEED)
        return 0.0;
    if (known == POSITION)
        return -(v[STIFFNESS] + (s->touching ? v[STOP_STIFFNESS] : 0.0)) / v[MASS];
    if (known == SPEED)
        return -(v[DAMPING] + (s->touching ? STOP_DAMPING : 0.0)) / v[MASS];
#ifndef SAMPLED
    if (known == FORCE)
        return 1.0 / v[MASS];
#endif
    return 0.0;
}
