
/* Sigmoid in Q0.31 from -16 to 16: 1 / (1 + exp(-z)). */
static const chord_table SIGMOID = {
@sigmoid@};

/* Sigmoid of z in Q15.16. */
static int32_t sigmoid(int32_t z)
{
    return interpolate(SIGMOID, clamp(z, -1048576, 1048575), 12u);
}
