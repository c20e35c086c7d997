
/* Hyperbolic tangent in Q1.30 from -8 to 8. */
static const chord_table TANH = {
@tanh@};

/* Hyperbolic tangent of z in Q15.16. */
static int32_t hyperbolic_tangent(int32_t z)
{
    return interpolate(TANH, clamp(z, -524288, 524287), 11u);
}
