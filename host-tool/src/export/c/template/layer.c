
/* A layer of the LSTM. Rows are in gate order i, f, g, o, and in each gate there is one row a unit. */
typedef struct {
    uint32_t inputs;
    uint32_t units;
    const int8_t *input_weights;
    const int8_t *recurrent_weights;
    const int32_t *input_scales;
    const int32_t *recurrent_scales;
    const int64_t *biases;   /* Q15.48, the constant that rounds included */
    uint32_t cell_exponent;  /* k: cell states are in Q1.30 of 2^k */
    int32_t cell_limit;      /* bound of the stored cell state */
    uint32_t hidden_shift;   /* to the 16 bits of the hidden state */
} layer_parameters;

#define MOST_UNITS @most_units@u

static int32_t dot(const int8_t *weights, const int16_t *values, uint32_t count)
{
    int32_t sum = 0;
    uint32_t index;

    for (index = 0u; index < count; index++) {
        sum += (int32_t)weights[index] * (int32_t)values[index];
    }
    return sum;
}

/* z = W x + U h + b of one row, in Q15.16. */
static int32_t pre_activation(const layer_parameters *layer, uint32_t row, const int16_t *input, const int16_t *hidden)
{
    const int32_t from_input = dot(&layer->input_weights[row * layer->inputs], input, layer->inputs);
    const int32_t from_hidden = dot(&layer->recurrent_weights[row * layer->units], hidden, layer->units);

    return upper(layer->biases[row] + ((int64_t)from_input * layer->input_scales[row])
        + ((int64_t)from_hidden * layer->recurrent_scales[row]));
}

/*
 * One step of a layer: moves its cell states c and hidden states h on.
 *
 *   i, f, o = sigmoid(z)    g = act(z)    c = clamp(f * c + i * g)    h = o * act(c)      act: @activation@
 */
static void step_layer(const layer_parameters *layer, const int16_t *input, int32_t *cells, int16_t *hidden)
{
    const uint32_t units = layer->units;
    const uint32_t to_cell = 14u - layer->cell_exponent;
    const int32_t half_limit = layer->cell_limit / 2;
    int16_t next[MOST_UNITS];
    uint32_t unit;

    for (unit = 0u; unit < units; unit++) {
        const int32_t input_gate = sigmoid(pre_activation(layer, unit, input, hidden));
        const int32_t forget_gate = sigmoid(pre_activation(layer, units + unit, input, hidden));
        const int32_t z = pre_activation(layer, (2u * units) + unit, input, hidden);
        const int32_t output_gate = sigmoid(pre_activation(layer, (3u * units) + unit, input, hidden));
        const int32_t candidate = @candidate@;
        const int32_t sum = multiply_high(forget_gate, cells[unit]) + multiply_high(input_gate, candidate);
        const int32_t cell = 2 * clamp(sum, -half_limit, half_limit - 1);
        const int32_t activated = @activated@;
        const int32_t product_high = multiply_high(output_gate, activated) + power_of_two(layer->hidden_shift - 1u);

        cells[unit] = cell;
        next[unit] = (int16_t)clamp(shift_right(product_high, layer->hidden_shift), -32768, 32767);
    }
    for (unit = 0u; unit < units; unit++) {
        hidden[unit] = next[unit];
    }
}
