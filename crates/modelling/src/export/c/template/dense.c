
/* A dense layer, h = act(W x + b), act: @activation@. */
static void step_dense_@name@(const layer_parameters *layer, const int16_t *input, int16_t *output)
{
    uint32_t unit;

    for (unit = 0u; unit < layer->units; unit++) {
        const int32_t from_input = dot(&layer->input_weights[unit * layer->inputs], input, layer->inputs);
        const int32_t z = upper(layer->biases[unit] + ((int64_t)from_input * layer->input_scales[unit]));
        const int32_t activated = @candidate@;
        const int32_t rounded = shift_right(activated + power_of_two(layer->hidden_shift), layer->hidden_shift + 1u);

        output[unit] = (int16_t)clamp(rounded, -32768, 32767);
    }
}
