
/* Input channel: u = (x - INPUT_OFFSET) / INPUT_SCALE. */
static const float INPUT_OFFSET = @input_offset@
static const float INPUT_SCALE = @input_scale@
/* More spans than this from the channel's centre is no measurement. */
static const float MOST_NORMALISED = @most_normalised@
/* Stands in for the input until the first good sample. */
static const float REST = @rest@
@lag_constant@/* Linear sum: p = BIAS + INPUT_WEIGHT * v + s + sum of q * C. */
static const float BIAS = @bias@
static const float INPUT_WEIGHT = @input_weight@

/*
 * The physics: one sample x gives the readout L in normalised output@and_features@.
 *
 *   u = (x - offset) / scale    v += lag * (delay(u) - v)    s = sum of w * H    p = bias + weight * v + s + sum of q * C
 */
static float step_front_end(@name@_state *state, float raw@features_argument@)
{
    const float measured = (raw - INPUT_OFFSET) / INPUT_SCALE;
    const bool good = (measured >= -MOST_NORMALISED) && (measured <= MOST_NORMALISED);
    const bool first = !state->started;
    const float input = good ? measured : (first ? REST : state->input);
@last_values@    float delayed;
    float path;
    float sum = 0.0f;
    float linear;
    float readout;
    uint32_t index;

    if ((!good) && (state->held_samples < UINT32_MAX)) {
        state->held_samples++;
    }
    if (first) {
        for (index = 0u; index < DELAY_LINE; index++) {
            state->delay_line[index] = input;
        }
@start_plays@        /* A stand-in is no start: the first good sample finds its own equilibrium. */
        state->started = good;
    }
    delayed = delay(state, input);
    path = @path@;
@plays@    linear = BIAS + product(INPUT_WEIGHT, path) + sum;
@creeps@    readout = @readout@;
    state->input = input;
    state->path = path;
@features@    return readout;
}
