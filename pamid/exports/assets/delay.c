/* Takes `in` into a delay line of n values and returns the one `seconds` ago, linear between steps. */
static double delayed(double line[], int n, int *head, int begin, double in, double seconds)
{
    double position, part;
    int i, whole;

    *head = (*head + 1) % n;
    if (begin) {
        for (i = 0; i < n; i++) {
            line[i] = in;
        }
    }
    line[*head] = in;
    position = seconds / STEP;
    position = position > 0.0 ? position : 0.0;
    position = position < n - 2.0 ? position : n - 2.0;
    whole = (int)position;
    part = position - whole;
    return (1.0 - part) * line[(*head - whole + n) % n] + part * line[(*head - whole - 1 + n) % n];
}
