/* $title: one sample of an identified model, made by pamid.

   $model m;
   double u[$inputs], y[$outputs];
   ${model}_init(&m);
   every $period s: fill u; ${model}_step(&m, u, y);

   All of the state is in the struct: copying it saves it, copying it back rewinds. No memory is taken, nothing is
   global, the only library is libm. Units are those of the names. */
#ifndef ${MODEL}_H
#define ${MODEL}_H

#define ${MODEL}_PERIOD_S $period
#define ${MODEL}_INPUTS $inputs
#define ${MODEL}_OUTPUTS $outputs
#define ${MODEL}_PARAMETERS $parameters

/* Places in u, y and p: name, unit, what it is. */
$places

typedef struct {
$fields
} $model;

/* The identified parameters, and the start. */
void ${model}_init($model *m);

/* Back to the start, with the parameters as they are. */
void ${model}_start($model *m);

/* To be called where parameters were changed while the model runs. */
void ${model}_prepare($model *m);

/* y: the outputs at this instant, with the inputs u of this instant. Then one period on, with u held.
   Returns 0, or 1 where the state is no longer finite. */
int ${model}_step($model *m, const double u[], double y[]);

/* y as the next step would give it; the state stays. Takes a copy of the struct on the stack. */
void ${model}_outputs(const $model *m, const double u[], double y[]);

#endif
