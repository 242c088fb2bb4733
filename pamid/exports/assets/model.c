#include "$model.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#define NX $states
#define SUBSTEPS $substeps
#define PERIOD $period
#define STEP (PERIOD / SUBSTEPS)

typedef $model model;

$body

int ${model}_step(model *m, const double u[], double y[])
{
    int i, s;

    for (s = 0; s < SUBSTEPS; s++) {
        const double time = (double)m->samples * PERIOD + s * STEP;
$update        if (s == 0) {
            readings(m, u, time, y);
        }
        integrate(m, u, time);
    }
    m->samples++;
    for (i = 0; i < NX; i++) {
        if (!(fabs(m->x[i]) < 1e15)) {
            return 1;
        }
    }
    return 0;
}

void ${model}_outputs(const model *m, const double u[], double y[])
{
    const double time = (double)m->samples * PERIOD;
    model now = *m;

$look    readings(&now, u, time, y);
}
