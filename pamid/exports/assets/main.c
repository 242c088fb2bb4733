/* An example of a host: reads rows of inputs as CSV (a header, then numbers; columns that the model does not know are
   passed over, optional ones may be missing) and writes the outputs of every sample.

   cc -std=c99 -O2 main.c $model.c -lm -o $model && ./$model < excitation.csv > simulated.csv */
#include "$model.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MOST 256   /* columns of the CSV */

static const char *const inputs[] = {$inputs};
static const int required[] = {$required};
static const double otherwise[] = {$starts};   /* of an optional input that has no column */
static const char *const outputs[] = {$outputs};

int main(void)
{
    static char line[65536];
    $model m;
    double u[$n_inputs], y[$n_outputs];
    int place[MOST], seen[$n_inputs] = {0}, columns = 0, i;
    long row = 1;
    char *word, *end;

    if (!fgets(line, sizeof line, stdin)) {
        fprintf(stderr, "there is no header\n");
        return 1;
    }
    for (word = strtok(line, ",\r\n"); word && columns < MOST; word = strtok(NULL, ",\r\n")) {
        place[columns] = -1;
        for (i = 0; i < $n_inputs; i++) {
            if (inputs[i] && !strcmp(word, inputs[i])) {
                place[columns] = i;
                seen[i] = 1;
            }
        }
        columns++;
    }
    for (i = 0; i < $n_inputs; i++) {
        if (required[i] && !seen[i]) {
            fprintf(stderr, "the input column %s is missing\n", inputs[i]);
            return 1;
        }
    }
    memcpy(u, otherwise, sizeof u);
    for (i = 0; i < $n_outputs; i++) {
        printf("%s%s", i ? "," : "", outputs[i]);
    }
    printf("\n");
    ${model}_init(&m);
    while (fgets(line, sizeof line, stdin)) {
        row++;
        if (strspn(line, " \r\n") == strlen(line)) {
            continue;
        }
        for (i = 0, word = strtok(line, ",\r\n"); word && i < columns; i++, word = strtok(NULL, ",\r\n")) {
            if (place[i] >= 0) {
                u[place[i]] = strtod(word, &end);
                if (end == word) {
                    fprintf(stderr, "row %ld: %s is not a number\n", row, word);
                    return 1;
                }
            }
        }
        if (i < columns) {
            fprintf(stderr, "row %ld has %d cells of %d\n", row, i, columns);
            return 1;
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
