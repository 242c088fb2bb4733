/* The slider behind the functions of FMI 2.0. */
#include "fmi2FunctionTypes.h"
#include "slider.h"

#define OUT __attribute__((visibility("default")))
#define REAL(s, r) ((s)->v[r])

OUT const char *fmi2GetTypesPlatform(void) { return "default"; }
OUT const char *fmi2GetVersion(void) { return "2.0"; }
OUT fmi2Status fmi2SetDebugLogging(void *c, fmi2Boolean on, size_t n, const fmi2String names[])
{
    (void)c, (void)on, (void)n, (void)names;
    return fmi2OK;
}

OUT void *fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                          const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                          fmi2Boolean logging)
{
    Slider *s = calloc(1, sizeof *s);
    (void)name, (void)resources, (void)functions, (void)visible, (void)logging;
    if (strcmp(guid, "{slider}") != 0) {
        free(s);
        return NULL;
    }
    s->exchange = type == fmi2ModelExchange;
    start(s);
    return s;
}

OUT void fmi2FreeInstance(void *c) { free(c); }
OUT fmi2Status fmi2SetupExperiment(void *c, fmi2Boolean tol, fmi2Real t, fmi2Real from,
                                   fmi2Boolean stops, fmi2Real to)
{
    (void)tol, (void)t, (void)stops, (void)to;
    ((Slider *)c)->v[TIME] = from;
    return fmi2OK;
}
OUT fmi2Status fmi2EnterInitializationMode(void *c) { (void)c; return fmi2OK; }
OUT fmi2Status fmi2ExitInitializationMode(void *c)
{
    Slider *s = c;
    if (!s->exchange)
        discrete(s);
    return fmi2OK;
}
OUT fmi2Status fmi2Terminate(void *c) { (void)c; return fmi2OK; }
OUT fmi2Status fmi2Reset(void *c) { start(c); return fmi2OK; }

OUT fmi2Status fmi2GetReal(void *c, const unsigned r[], size_t n, fmi2Real value[])
{
    rates(c);
    for (size_t i = 0; i < n; i++)
        value[i] = REAL((Slider *)c, r[i]);
    return fmi2OK;
}
OUT fmi2Status fmi2SetReal(void *c, const unsigned r[], size_t n, const fmi2Real value[])
{
    for (size_t i = 0; i < n; i++)
        REAL((Slider *)c, r[i]) = value[i];
    return fmi2OK;
}
OUT fmi2Status fmi2GetInteger(void) { return fmi2Error; }
OUT fmi2Status fmi2GetString(void) { return fmi2Error; }
OUT fmi2Status fmi2SetInteger(void) { return fmi2Error; }
OUT fmi2Status fmi2SetBoolean(void) { return fmi2Error; }
OUT fmi2Status fmi2SetString(void) { return fmi2Error; }
OUT fmi2Status fmi2GetBoolean(void *c, const unsigned r[], size_t n, fmi2Boolean value[])
{
    (void)r;
    for (size_t i = 0; i < n; i++)
        value[i] = ((Slider *)c)->touching;
    return fmi2OK;
}

OUT fmi2Status fmi2GetFMUstate(void *c, fmi2FMUstate *kept)
{
    if (!*kept)
        *kept = malloc(sizeof(Slider));
    memcpy(*kept, c, sizeof(Slider));
    return fmi2OK;
}
OUT fmi2Status fmi2SetFMUstate(void *c, fmi2FMUstate kept)
{
    memcpy(c, kept, sizeof(Slider));
    return fmi2OK;
}
OUT fmi2Status fmi2FreeFMUstate(void *c, fmi2FMUstate *kept)
{
    (void)c;
    free(*kept);
    *kept = NULL;
    return fmi2OK;
}
OUT fmi2Status fmi2SerializedFMUstateSize(void) { return fmi2Error; }
OUT fmi2Status fmi2SerializeFMUstate(void) { return fmi2Error; }
OUT fmi2Status fmi2DeSerializeFMUstate(void) { return fmi2Error; }

OUT fmi2Status fmi2GetDirectionalDerivative(void *c, const unsigned unknown[], size_t nu,
                                            const unsigned known[], size_t nk,
                                            const fmi2Real dv[], fmi2Real found[])
{
    for (size_t i = 0; i < nu; i++) {
        found[i] = 0.0;
        for (size_t k = 0; k < nk; k++)
            found[i] += partial(c, unknown[i], known[k]) * dv[k];
    }
    return fmi2OK;
}

/* ---- model exchange ---- */

OUT fmi2Status fmi2EnterEventMode(void *c) { (void)c; return fmi2OK; }
OUT fmi2Status fmi2NewDiscreteStates(void *c, fmi2EventInfo *info)
{
    Slider *s = c;
    memset(info, 0, sizeof *info);
    info->newDiscreteStatesNeeded = discrete(s);
#ifdef SAMPLED
    info->nextEventTimeDefined = fmi2True;
    info->nextEventTime = next_event(s);
#endif
    return fmi2OK;
}
OUT fmi2Status fmi2EnterContinuousTimeMode(void *c) { (void)c; return fmi2OK; }
OUT fmi2Status fmi2CompletedIntegratorStep(void *c, fmi2Boolean no, fmi2Boolean *event,
                                           fmi2Boolean *ends)
{
    (void)c, (void)no;
    *event = *ends = fmi2False;
    return fmi2OK;
}
OUT fmi2Status fmi2SetTime(void *c, fmi2Real t) { ((Slider *)c)->v[TIME] = t; return fmi2OK; }
OUT fmi2Status fmi2SetContinuousStates(void *c, const fmi2Real x[], size_t n)
{
    memcpy(&((Slider *)c)->v[POSITION], x, n * sizeof *x);
    return fmi2OK;
}
OUT fmi2Status fmi2GetDerivatives(void *c, fmi2Real dx[], size_t n)
{
    if (fault(c))
        return fmi2Error;
    rates(c);
    memcpy(dx, &((Slider *)c)->v[DER_POSITION], n * sizeof *dx);
    return fmi2OK;
}
OUT fmi2Status fmi2GetEventIndicators(void *c, fmi2Real z[], size_t n)
{
    if (n)
        z[0] = indicator(c);
    return fmi2OK;
}
OUT fmi2Status fmi2GetContinuousStates(void *c, fmi2Real x[], size_t n)
{
    memcpy(x, &((Slider *)c)->v[POSITION], n * sizeof *x);
    return fmi2OK;
}
OUT fmi2Status fmi2GetNominalsOfContinuousStates(void *c, fmi2Real x[], size_t n)
{
    (void)c;
    for (size_t i = 0; i < n; i++)
        x[i] = 1.0;
    return fmi2OK;
}

/* ---- co-simulation ---- */

OUT fmi2Status fmi2DoStep(void *c, fmi2Real t, fmi2Real h, fmi2Boolean no)
{
    (void)no;
    ((Slider *)c)->v[TIME] = t;
    return advance(c, h) ? fmi2Error : fmi2OK;
}
OUT fmi2Status fmi2SetRealInputDerivatives(void) { return fmi2Error; }
OUT fmi2Status fmi2GetRealOutputDerivatives(void) { return fmi2Error; }
OUT fmi2Status fmi2CancelStep(void) { return fmi2Error; }
OUT fmi2Status fmi2GetStatus(void) { return fmi2Error; }
OUT fmi2Status fmi2GetRealStatus(void) { return fmi2Error; }
OUT fmi2Status fmi2GetIntegerStatus(void) { return fmi2Error; }
OUT fmi2Status fmi2GetBooleanStatus(void) { return fmi2Error; }
OUT fmi2Status fmi2GetStringStatus(void) { return fmi2Error; }
