/* One Runge-Kutta step of order 4 with the inputs and cells held. */
static void integrate(model *m, const double u[], double time)
{
    static const double weight[4] = {STEP / 6.0, STEP / 3.0, STEP / 3.0, STEP / 6.0};
    static const double reach[4] = {0.5 * STEP, 0.5 * STEP, STEP, STEP};
    double x[NX], f[NX], total[NX] = {0.0};
    int i, stage;

    for (i = 0; i < NX; i++) {
        x[i] = m->x[i];
    }
    for (stage = 0; stage < 4; stage++) {
        rates(m, x, u, time, f);
        for (i = 0; i < NX; i++) {
            total[i] += weight[stage] * f[i];
            x[i] = m->x[i] + reach[stage] * f[i];
        }
    }
    for (i = 0; i < NX; i++) {
        m->x[i] += total[i];
    }
}
