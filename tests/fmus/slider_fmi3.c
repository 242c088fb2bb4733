/* The slider behind the functions of FMI 3.0. */
#include "fmi3PlatformTypes.h"
#include "fmi3FunctionTypes.h"
#include "slider.h"

#define OUT __attribute__((visibility("default")))
#define NONE_OF(name) OUT fmi3Status name(void) { return fmi3Error; }

OUT const char *fmi3GetVersion(void) { return "3.0"; }

static void *made(const char *token, int exchange)
{
    Slider *s = calloc(1, sizeof *s);
    if (strcmp(token, "{slider}") != 0) {
        free(s);
        return NULL;
    }
    s->exchange = exchange;
    start(s);
    return s;
}
OUT void *fmi3InstantiateModelExchange(const char *name, const char *token)
{
    (void)name;
    return made(token, 1);
}
OUT void *fmi3InstantiateCoSimulation(const char *name, const char *token)
{
    (void)name;
    return made(token, 0);
}
OUT void *fmi3InstantiateScheduledExecution(void) { return NULL; }
OUT void fmi3FreeInstance(void *c) { free(c); }

OUT fmi3Status fmi3EnterInitializationMode(void *c, fmi3Boolean tol, double t, double from,
                                           fmi3Boolean stops, double to)
{
    (void)tol, (void)t, (void)stops, (void)to;
    ((Slider *)c)->v[TIME] = from;
    return fmi3OK;
}
OUT fmi3Status fmi3ExitInitializationMode(void *c)
{
    Slider *s = c;
    if (!s->exchange)
        discrete(s);
    return fmi3OK;
}
OUT fmi3Status fmi3Terminate(void *c) { (void)c; return fmi3OK; }
OUT fmi3Status fmi3Reset(void *c) { start(c); return fmi3OK; }
OUT fmi3Status fmi3EnterEventMode(void *c) { (void)c; return fmi3OK; }

OUT fmi3Status fmi3GetFloat64(void *c, const unsigned r[], size_t n, double value[], size_t m)
{
    (void)m;
    rates(c);
    for (size_t i = 0; i < n; i++)
        value[i] = ((Slider *)c)->v[r[i]];
    return fmi3OK;
}
OUT fmi3Status fmi3SetFloat64(void *c, const unsigned r[], size_t n, const double value[], size_t m)
{
    if (m != n)
        return fmi3Error;
    for (size_t i = 0; i < n; i++)
        ((Slider *)c)->v[r[i]] = value[i];
    return fmi3OK;
}
OUT fmi3Status fmi3GetBoolean(void *c, const unsigned r[], size_t n, fmi3Boolean value[], size_t m)
{
    (void)r, (void)m;
    for (size_t i = 0; i < n; i++)
        value[i] = ((Slider *)c)->touching;
    return fmi3OK;
}

OUT fmi3Status fmi3GetFMUState(void *c, fmi3FMUState *kept)
{
    if (!*kept)
        *kept = malloc(sizeof(Slider));
    memcpy(*kept, c, sizeof(Slider));
    return fmi3OK;
}
OUT fmi3Status fmi3SetFMUState(void *c, fmi3FMUState kept)
{
    memcpy(c, kept, sizeof(Slider));
    return fmi3OK;
}
OUT fmi3Status fmi3FreeFMUState(void *c, fmi3FMUState *kept)
{
    (void)c;
    free(*kept);
    *kept = NULL;
    return fmi3OK;
}

OUT fmi3Status fmi3GetDirectionalDerivative(void *c, const unsigned unknown[], size_t nu,
                                            const unsigned known[], size_t nk, const double dv[],
                                            size_t ns, double found[], size_t nf)
{
    if (ns != nk || nf != nu)
        return fmi3Error;
    for (size_t i = 0; i < nu; i++) {
        found[i] = 0.0;
        for (size_t k = 0; k < nk; k++)
            found[i] += partial(c, unknown[i], known[k]) * dv[k];
    }
    return fmi3OK;
}

/* ---- model exchange ---- */

OUT fmi3Status fmi3UpdateDiscreteStates(void *c, fmi3Boolean *more, fmi3Boolean *ends,
                                        fmi3Boolean *nominals, fmi3Boolean *values,
                                        fmi3Boolean *due, double *when)
{
    *more = discrete(c);
    *ends = *nominals = *values = *due = 0;
#ifdef SAMPLED
    *due = 1;
    *when = next_event(c);
#else
    (void)when;
#endif
    return fmi3OK;
}
OUT fmi3Status fmi3EnterContinuousTimeMode(void *c) { (void)c; return fmi3OK; }
OUT fmi3Status fmi3CompletedIntegratorStep(void *c, fmi3Boolean no, fmi3Boolean *event,
                                           fmi3Boolean *ends)
{
    (void)c, (void)no;
    *event = *ends = 0;
    return fmi3OK;
}
OUT fmi3Status fmi3SetTime(void *c, double t) { ((Slider *)c)->v[TIME] = t; return fmi3OK; }
OUT fmi3Status fmi3SetContinuousStates(void *c, const double x[], size_t n)
{
    memcpy(&((Slider *)c)->v[POSITION], x, n * sizeof *x);
    return fmi3OK;
}
OUT fmi3Status fmi3GetContinuousStateDerivatives(void *c, double dx[], size_t n)
{
    if (fault(c))
        return fmi3Error;
    rates(c);
    memcpy(dx, &((Slider *)c)->v[DER_POSITION], n * sizeof *dx);
    return fmi3OK;
}
OUT fmi3Status fmi3GetEventIndicators(void *c, double z[], size_t n)
{
    if (n)
        z[0] = indicator(c);
    return fmi3OK;
}
OUT fmi3Status fmi3GetContinuousStates(void *c, double x[], size_t n)
{
    memcpy(x, &((Slider *)c)->v[POSITION], n * sizeof *x);
    return fmi3OK;
}
OUT fmi3Status fmi3GetNominalsOfContinuousStates(void *c, double x[], size_t n)
{
    (void)c;
    for (size_t i = 0; i < n; i++)
        x[i] = 1.0;
    return fmi3OK;
}
OUT fmi3Status fmi3GetNumberOfEventIndicators(void *c, size_t *n) { (void)c; *n = 1; return fmi3OK; }
OUT fmi3Status fmi3GetNumberOfContinuousStates(void *c, size_t *n) { (void)c; *n = 2; return fmi3OK; }

/* ---- co-simulation ---- */

OUT fmi3Status fmi3DoStep(void *c, double t, double h, fmi3Boolean no, fmi3Boolean *event,
                          fmi3Boolean *ends, fmi3Boolean *early, double *last)
{
    (void)no;
    ((Slider *)c)->v[TIME] = t;
    *event = *ends = *early = 0;
    *last = t + h;
    return advance(c, h) ? fmi3Error : fmi3OK;
}

/* ---- what it has no use for ---- */

NONE_OF(fmi3GetFloat32)
NONE_OF(fmi3GetInt8)
NONE_OF(fmi3GetUInt8)
NONE_OF(fmi3GetInt16)
NONE_OF(fmi3GetUInt16)
NONE_OF(fmi3GetInt32)
NONE_OF(fmi3GetUInt32)
NONE_OF(fmi3GetInt64)
NONE_OF(fmi3GetUInt64)
NONE_OF(fmi3GetString)
NONE_OF(fmi3GetBinary)
NONE_OF(fmi3GetClock)
NONE_OF(fmi3SetFloat32)
NONE_OF(fmi3SetInt8)
NONE_OF(fmi3SetUInt8)
NONE_OF(fmi3SetInt16)
NONE_OF(fmi3SetUInt16)
NONE_OF(fmi3SetInt32)
NONE_OF(fmi3SetUInt32)
NONE_OF(fmi3SetInt64)
NONE_OF(fmi3SetUInt64)
NONE_OF(fmi3SetBoolean)
NONE_OF(fmi3SetString)
NONE_OF(fmi3SetBinary)
NONE_OF(fmi3SetClock)
NONE_OF(fmi3GetNumberOfVariableDependencies)
NONE_OF(fmi3GetVariableDependencies)
NONE_OF(fmi3SerializedFMUStateSize)
NONE_OF(fmi3SerializeFMUState)
NONE_OF(fmi3DeserializeFMUState)
NONE_OF(fmi3GetAdjointDerivative)
NONE_OF(fmi3EnterConfigurationMode)
NONE_OF(fmi3ExitConfigurationMode)
NONE_OF(fmi3GetIntervalDecimal)
NONE_OF(fmi3GetIntervalFraction)
NONE_OF(fmi3GetShiftDecimal)
NONE_OF(fmi3GetShiftFraction)
NONE_OF(fmi3SetIntervalDecimal)
NONE_OF(fmi3SetIntervalFraction)
NONE_OF(fmi3SetShiftDecimal)
NONE_OF(fmi3SetShiftFraction)
NONE_OF(fmi3EvaluateDiscreteStates)
NONE_OF(fmi3EnterStepMode)
NONE_OF(fmi3GetOutputDerivatives)
NONE_OF(fmi3ActivateModelPartition)
NONE_OF(fmi3SetDebugLogging)
