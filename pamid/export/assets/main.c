/* An example of a host: reads rows of inputs as CSV (a header, then numbers; columns that the model does not know are
   passed over) and writes the outputs of every sample.

   cc -std=c99 -O2 main.c $model.c -lm -o $model && ./$model < excitation.csv > simulated.csv */
#include "$model.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MOST 256   /* columns of the CSV */

static const char *const inputs[] = {$inputs};
static const double otherwise[] = {$starts};
static const char *const outputs[] = {$outputs};

int main(void)
{
    static char line[65536];
    $model m;
    double u[$n_inputs], y[$n_outputs];
    int place[MOST], columns = 0, i;
    char *word;

    if (!fgets(line, sizeof line, stdin)) {
        fprintf(stderr, "there is no header\n");
        return 1;
    }
    for (word = strtok(line, ",\r\n"); word && columns < MOST; word = strtok(NULL, ",\r\n")) {
        place[columns] = -1;
        for (i = 0; i < $n_inputs; i++) {
            if (inputs[i] && !strcmp(word, inputs[i])) {
                place[columns] = i;
            }
        }
        columns++;
    }
    memcpy(u, otherwise, sizeof u);
    for (i = 0; i < $n_outputs; i++) {
        printf("%s%s", i ? "," : "", outputs[i]);
    }
    printf("\n");
    ${model}_init(&m);
    while (fgets(line, sizeof line, stdin)) {
        for (i = 0, word = strtok(line, ",\r\n"); word && i < columns; i++, word = strtok(NULL, ",\r\n")) {
            if (place[i] >= 0) {
                u[place[i]] = strtod(word, NULL);
            }
        }
        if (${model}_step(&m, u, y)) {
            fprintf(stderr, "the model became unstable\n");
            return 1;
        }
        for (i = 0; i < $n_outputs; i++) {
            printf("%s%.17g", i ? "," : "", y[i]);
        }
        printf("\n");
    }
    return 0;
}
