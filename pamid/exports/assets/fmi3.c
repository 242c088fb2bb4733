/* FMI 3.0 for co-simulation. */
#include "fmu.h"

#include "fmi3Functions.h"

typedef struct {
    plant c;
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
} instance;

static fmi3Status fail(const instance *i, const char *why)
{
    if (i->log) {
        i->log(i->environment, fmi3Error, "logStatusError", why);
    }
    return fmi3Error;
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean loggingOn, size_t nCategories, const fmi3String categories[])
{
    (void)c;
    (void)loggingOn;
    (void)nCategories;
    (void)categories;
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
    const fmi3ValueReference requiredIntermediateVariables[], size_t nRequiredIntermediateVariables,
    fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
    fmi3IntermediateUpdateCallback intermediateUpdate)
{
    instance *i;

    (void)instanceName;
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    (void)eventModeUsed;
    (void)earlyReturnAllowed;
    (void)requiredIntermediateVariables;
    (void)nRequiredIntermediateVariables;
    (void)intermediateUpdate;
    if (!instantiationToken || strcmp(instantiationToken, TOKEN)) {
        return NULL;
    }
    i = malloc(sizeof *i);
    if (i) {
        begin(&i->c);
        i->log = logMessage;
        i->environment = instanceEnvironment;
    }
    return i;
}

void fmi3FreeInstance(fmi3Instance c)
{
    free(c);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    (void)toleranceDefined;
    (void)tolerance;
    (void)stopTimeDefined;
    (void)stopTime;
    ((instance *)c)->c.start = ((instance *)c)->c.time = startTime;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    settle(&((instance *)c)->c);
    ((instance *)c)->c.running = 1;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance c)
{
    (void)c;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance c)
{
    begin(&((instance *)c)->c);
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Float64 values[], size_t nValues)
{
    instance *i = c;
    size_t k;

    for (k = 0; k < nValueReferences; k++) {
        if (nValues != nValueReferences || !get(&i->c, valueReferences[k], &values[k])) {
            return fail(i, "there is no such variable");
        }
    }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Float64 values[], size_t nValues)
{
    instance *i = c;
    size_t k;

    for (k = 0; k < nValueReferences; k++) {
        if (nValues != nValueReferences || !set(&i->c, valueReferences[k], values[k])) {
            return fail(i, "there is no such input or parameter");
        }
    }
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    instance *i = c;
    const char *why = advance(&i->c, currentCommunicationPoint + communicationStepSize);

    (void)noSetFMUStatePriorToCurrentPoint;
    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = fmi3False;
    *lastSuccessfulTime = i->c.time;
    return why ? fail(i, why) : fmi3OK;
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *FMUState)
{
    if (!*FMUState) {
        *FMUState = malloc(sizeof(plant));
    }
    if (!*FMUState) {
        return fail(c, "there is no memory for a state");
    }
    memcpy(*FMUState, &((instance *)c)->c, sizeof(plant));
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState FMUState)
{
    memcpy(&((instance *)c)->c, FMUState, sizeof(plant));
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *FMUState)
{
    (void)c;
    free(*FMUState);
    *FMUState = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState FMUState, size_t *size)
{
    (void)c;
    (void)FMUState;
    *size = sizeof(plant);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState FMUState, fmi3Byte serializedState[], size_t size)
{
    if (size != sizeof(plant)) {
        return fail(c, "a state has another size");
    }
    memcpy(serializedState, FMUState, size);
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState)
{
    if (size != sizeof(plant) || fmi3GetFMUState(c, FMUState) != fmi3OK) {
        return fail(c, "a state has another size");
    }
    memcpy(*FMUState, serializedState, size);
    return fmi3OK;
}

/* What this model does not offer. */
