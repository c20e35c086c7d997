
#define MOST_UNITS @most_units@u

/* z = W x + U h + b of a row that is in both matrices, in Q15.16. */
static int32_t pre_activation(const layer_parameters *layer, uint32_t row, const int16_t *input, const int16_t *hidden)
{
    const int32_t from_input = dot(&layer->input_weights[row * layer->inputs], input, layer->inputs);
    const int32_t from_hidden = dot(&layer->recurrent_weights[row * layer->units], hidden, layer->units);

    return upper(layer->biases[row] + ((int64_t)from_input * layer->input_scales[row])
        + ((int64_t)from_hidden * layer->recurrent_scales[row]));
}
