/* FMI 2.0 for co-simulation. */
#include "fmu.h"

#include "fmi2Functions.h"

typedef struct {
    plant c;
    const char *name;
    fmi2CallbackLogger log;
    fmi2ComponentEnvironment environment;
} instance;

static fmi2Status fail(const instance *i, const char *why)
{
    if (i->log) {
        i->log(i->environment, i->name, fmi2Error, "logStatusError", "%s", why);
    }
    return fmi2Error;
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t n, const fmi2String categories[])
{
    (void)c;
    (void)loggingOn;
    (void)n;
    (void)categories;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    instance *i;
    size_t length;

    (void)fmuResourceLocation;
    (void)visible;
    (void)loggingOn;
    if (fmuType != fmi2CoSimulation || !fmuGUID || strcmp(fmuGUID, TOKEN) || !instanceName) {
        return NULL;
    }
    length = strlen(instanceName) + 1;
    i = malloc(sizeof *i + length);
    if (!i) {
        return NULL;
    }
    begin(&i->c);
    i->name = memcpy((char *)(i + 1), instanceName, length);
    i->log = functions ? functions->logger : NULL;
    i->environment = functions ? functions->componentEnvironment : NULL;
    return i;
}

void fmi2FreeInstance(fmi2Component c)
{
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    (void)toleranceDefined;
    (void)tolerance;
    (void)stopTimeDefined;
    (void)stopTime;
    ((instance *)c)->c.start = ((instance *)c)->c.time = startTime;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    settle(&((instance *)c)->c);
    ((instance *)c)->c.running = 1;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    begin(&((instance *)c)->c);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    instance *i = c;
    size_t k;

    for (k = 0; k < nvr; k++) {
        if (!get(&i->c, vr[k], &value[k])) {
            return fail(i, "there is no such variable");
        }
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    instance *i = c;
    size_t k;

    for (k = 0; k < nvr; k++) {
        if (!set(&i->c, vr[k], value[k])) {
            return fail(i, "there is no such input or parameter");
        }
    }
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    instance *i = c;
    const char *why = advance(&i->c, currentCommunicationPoint + communicationStepSize);

    (void)noSetFMUStatePriorToCurrentPoint;
    return why ? fail(i, why) : fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    if (!*FMUstate) {
        *FMUstate = malloc(sizeof(plant));
    }
    if (!*FMUstate) {
        return fail(c, "there is no memory for a state");
    }
    memcpy(*FMUstate, &((instance *)c)->c, sizeof(plant));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    memcpy(&((instance *)c)->c, FMUstate, sizeof(plant));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    (void)c;
    free(*FMUstate);
    *FMUstate = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    (void)c;
    (void)FMUstate;
    *size = sizeof(plant);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    if (size != sizeof(plant)) {
        return fail(c, "a state has another size");
    }
    memcpy(serializedState, FMUstate, size);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    if (size != sizeof(plant) || fmi2GetFMUstate(c, FMUstate) != fmi2OK) {
        return fail(c, "a state has another size");
    }
    memcpy(*FMUstate, serializedState, size);
    return fmi2OK;
}

/* What this model does not offer. */
