
/*
 * One step of an LSTM layer: moves its cell states c and hidden states h on. Its gates are i, f, g, o.
 *
 *   i, f, o = sigmoid(z)    g = act(z)    c = clamp(f * c + i * g)    h = o * act(c)      act: @activation@
 */
static void step_lstm(const layer_parameters *layer, const int16_t *input, int32_t *cells, int16_t *hidden)
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
