static double greatest(double a, double b)
{
    return a > b ? a : b;
}
