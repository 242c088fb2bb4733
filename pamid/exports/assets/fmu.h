/* What FMI 2.0 and FMI 3.0 share: the model between its communication points.

   Inputs hold from the instant at which they are set until they are set again. Inside, the model steps with its own
   fixed period, whatever the communication step: sample k stands at start + k periods, and a step that ends at t has
   taken floor((t - start) / period + 1e-6) of them. Outputs are those of the last sample not after t, with the inputs
   and parameters as they are when they are read. Hence at a communication step of one period: set the inputs of sample
   k, read the outputs of sample k, step; or set, step, read the outputs of sample k + 1 (with the inputs of sample k
   where an output depends on an input directly). */
#include "$model.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define NU ${MODEL}_INPUTS
#define NY ${MODEL}_OUTPUTS
#define NP ${MODEL}_PARAMETERS
#define TOKEN "$token"

typedef struct {
    $model m;
    double u[NU + 1], y[NY];
    double start, time;
    int running;   /* initialised */
    int changed;   /* a parameter, since it was last looked at */
    int known;     /* y is up to date */
} plant;

static void begin(plant *c)
{
    static const double u[NU + 1] = {$starts};

    memset(c, 0, sizeof *c);
    ${model}_init(&c->m);
    memcpy(c->u, u, sizeof u);
}

/* Takes changed parameters in. */
static void settle(plant *c)
{
    if (c->changed && c->running) {
        ${model}_prepare(&c->m);
    } else if (c->changed) {
        ${model}_start(&c->m);
    }
    c->changed = 0;
}

/* 0 where there is no such variable. */
static int get(plant *c, unsigned int reference, double *value)
{
    const long long k = reference;

    if (k < NU) {
        *value = c->u[k];
    } else if (k < NU + NY) {
        if (!c->known) {
            settle(c);
            ${model}_outputs(&c->m, c->u, c->y);
            c->known = 1;
        }
        *value = c->y[k - NU];
    } else if (k < NU + NY + NP) {
        *value = $parameter;
    } else if (k == NU + NY + NP) {
        *value = c->time;
    } else {
        return 0;
    }
    return 1;
}

/* 0 where there is no such input or parameter. */
static int set(plant *c, unsigned int reference, double value)
{
    const long long k = reference;

    c->known = 0;
    if (k < NU) {
        c->u[k] = value;
    } else if (k >= NU + NY && k < NU + NY + NP) {
        $parameter = value;
        c->changed = 1;
    } else {
        return 0;
    }
    return 1;
}

/* To the end of a communication step; NULL, or what went wrong. */
static const char *advance(plant *c, double until)
{
    const long long last = (long long)floor((until - c->start) / ${MODEL}_PERIOD_S + 1e-6);
    double y[NY];

    if (last < c->m.samples) {
        return "time went back; restore a state first";
    }
    settle(c);
    c->time = until;
    c->known = 0;
    while (c->m.samples < last) {
        if (${model}_step(&c->m, c->u, y)) {
            return "the model became unstable";
        }
    }
    return NULL;
}
