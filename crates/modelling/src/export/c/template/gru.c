
/* A sum that stays within 32 bits. */
static int32_t saturated_sum(int32_t left, int32_t right)
{
    const int64_t sum = (int64_t)left + right;

    return (sum > INT32_MAX) ? INT32_MAX : ((sum < INT32_MIN) ? INT32_MIN : (int32_t)sum);
}

/*
 * One step of a GRU layer: moves its states on, wide ones c and their 16 bits h. Its gates are r, u, n, m; rows of n are in the input
 * matrix only, those of m in the recurrent matrix only.
 *
 *   r, u = sigmoid(z)    q = act(z_n + r * z_m)    c = (1 - u) * q + u * c    h = c      act: @activation@
 */
static void step_gru(const layer_parameters *layer, const int16_t *input, int32_t *states, int16_t *hidden)
{
    const uint32_t units = layer->units;
@to_cell@    const int32_t half_limit = layer->cell_limit / 2;
    int16_t next[MOST_UNITS];
    uint32_t unit;

    for (unit = 0u; unit < units; unit++) {
        const uint32_t row = (2u * units) + unit;
        const int32_t from_input = dot(&layer->input_weights[row * layer->inputs], input, layer->inputs);
        const int32_t from_hidden = dot(&layer->recurrent_weights[row * units], hidden, units);
        const int32_t z_n = upper(layer->biases[row] + ((int64_t)from_input * layer->input_scales[row]));
        const int32_t z_m = upper(layer->biases[row + units] + ((int64_t)from_hidden * layer->recurrent_scales[row]));
        const int32_t reset = sigmoid(pre_activation(layer, unit, input, hidden));
        const int32_t update = sigmoid(pre_activation(layer, units + unit, input, hidden));
        const int32_t part = multiply_high(reset, z_m);
        const int32_t z = saturated_sum(z_n, saturated_sum(part, part));
        const int32_t candidate = @candidate@;
        const int32_t sum = multiply_high(update, states[unit]) + multiply_high(INT32_MAX - update, candidate);
        const int32_t state = 2 * clamp(sum, -half_limit, half_limit - 1);
        const int32_t rounded = shift_right(state + power_of_two(layer->hidden_shift), layer->hidden_shift + 1u);

        states[unit] = state;
        next[unit] = (int16_t)clamp(rounded, -32768, 32767);
    }
    for (unit = 0u; unit < units; unit++) {
        hidden[unit] = next[unit];
    }
}
