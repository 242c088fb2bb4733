/* LU of M in place with partial pivoting. */
static void factor(double M[NX][NX], int pivots[NX])
{
    int i, j, k, best;

    for (j = 0; j < NX; j++) {
        best = j;
        for (i = j + 1; i < NX; i++) {
            if (fabs(M[i][j]) > fabs(M[best][j])) {
                best = i;
            }
        }
        pivots[j] = best;
        for (k = 0; k < NX && best != j; k++) {
            const double swap = M[j][k];
            M[j][k] = M[best][k];
            M[best][k] = swap;
        }
        if (M[j][j] == 0.0) {
            M[j][j] = 1e-300;
        }
        for (i = j + 1; i < NX; i++) {
            M[i][j] /= M[j][j];
            for (k = j + 1; k < NX; k++) {
                M[i][k] -= M[i][j] * M[j][k];
            }
        }
    }
}

static void solve(double M[NX][NX], const int pivots[NX], double b[NX])
{
    int i, j;

    for (j = 0; j < NX; j++) {
        const double swap = b[j];
        b[j] = b[pivots[j]];
        b[pivots[j]] = swap;
    }
    for (j = 0; j < NX; j++) {
        for (i = j + 1; i < NX; i++) {
            b[i] -= M[i][j] * b[j];
        }
    }
    for (j = NX - 1; j >= 0; j--) {
        b[j] /= M[j][j];
        for (i = 0; i < j; i++) {
            b[i] -= M[i][j] * b[j];
        }
    }
}

/* Solves x = base + gh f(x) in place by damped Newton (Deuflhard 2004, section 3.3); 0 where it did not converge. */
static int newton(const model *m, double x[NX], const double base[NX], const double u[], double time, double gh)
{
    double f[NX], J[NX][NX], r[NX], before[NX], worst, left, reach;
    int pivots[NX], i, j, turn, halving;

    for (turn = 0; turn < 40; turn++) {
        slopes(m, x, u, time, f, J);
        for (i = 0; i < NX; i++) {
            for (j = 0; j < NX; j++) {
                J[i][j] = (i == j ? 1.0 : 0.0) - gh * J[i][j];
            }
            r[i] = base[i] + gh * f[i] - x[i];
        }
        factor(J, pivots);
        solve(J, pivots, r);
        worst = 0.0;
        for (i = 0; i < NX; i++) {
            worst = fmax(worst, fabs(r[i]) / (1e-6 + fabs(x[i])));
            before[i] = x[i];
        }
        reach = 1.0;
        for (halving = 0; halving < (worst > 1e-3 ? 20 : 1); halving++) {
            double q[NX];

            for (i = 0; i < NX; i++) {
                x[i] = before[i] + reach * r[i];
            }
            if (worst <= 1e-3) {
                break;
            }
            rates(m, x, u, time, f);
            for (i = 0; i < NX; i++) {
                q[i] = base[i] + gh * f[i] - x[i];
            }
            solve(J, pivots, q);
            left = 0.0;
            for (i = 0; i < NX; i++) {
                left = fmax(left, fabs(q[i]) / (1e-6 + fabs(before[i])));
            }
            if (left <= (1.0 - 0.25 * reach) * worst) {
                break;
            }
            reach *= 0.5;
        }
        if (worst < 1e-9) {
            return 1;
        }
    }
    return 0;
}

/* One step of the L-stable SDIRK2 (Alexander 1977) with the inputs and cells held. */
static void integrate(model *m, const double u[], double time)
{
    const double share = 1.0 - sqrt(0.5), gh = share * STEP;
    double k[NX] = {0.0}, base[NX];
    int i, stage;

    for (i = 0; i < NX; i++) {
        base[i] = m->x[i];
    }
    for (stage = 0; stage < 2; stage++) {
        double start[NX];

        for (i = 0; i < NX; i++) {
            start[i] = base[i] + (1.0 - share) * STEP * k[i];
        }
        if (!newton(m, m->x, start, u, time, gh)) {
            for (i = 0; i < NX; i++) {
                m->x[i] = NAN;
            }
            return;
        }
        for (i = 0; i < NX && stage == 0; i++) {
            k[i] = (m->x[i] - base[i]) / gh;
        }
    }
}
