
/* A layer. In each gate there is one row a unit; what a layer does not have is a null pointer. */
typedef struct {
    uint32_t inputs;
    uint32_t units;
    const int8_t *input_weights;
    const int8_t *recurrent_weights;
    const int32_t *input_scales;
    const int32_t *recurrent_scales;
    const int64_t *biases;   /* Q15.48, the constant that rounds included */
    uint32_t cell_exponent;  /* k: states are in Q1.30 of 2^k */
    int32_t cell_limit;      /* bound of the stored state */
    uint32_t hidden_shift;   /* to the 16 bits of the hidden state */
} layer_parameters;

static int32_t dot(const int8_t *weights, const int16_t *values, uint32_t count)
{
    int32_t sum = 0;
    uint32_t index;

    for (index = 0u; index < count; index++) {
        sum += (int32_t)weights[index] * (int32_t)values[index];
    }
    return sum;
}
