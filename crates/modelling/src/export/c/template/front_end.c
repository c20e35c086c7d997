
/* Input channels: u = (x - INPUT_OFFSETS) / INPUT_SCALES. */
#define INPUTS @inputs@u
static const float INPUT_OFFSETS[INPUTS] = {
@input_offsets@};
static const float INPUT_SCALES[INPUTS] = {
@input_scales@};
/* More spans than this from the channel's centre is no measurement. */
static const float MOST_NORMALISED = @most_normalised@
/* Stands in for an input until the first good sample. */
static const float RESTS[INPUTS] = {
@rests@};
@lag_constant@/* Linear sum: p = BIAS + sum of INPUT_WEIGHTS * v + s + sum of q * C. */
static const float BIAS = @bias@
static const float INPUT_WEIGHTS[INPUTS] = {
@input_weights@};
@lead@
/*
 * The physics: one sample x, a value of each input, gives the readout L in normalised output@and_features@.
 *
 *   u = (x - offset) / scale    v += lag * (delay(u) - v)    s = sum of w * H    p = bias + weight * v + s + sum of q * C
 */
static float step_front_end(@name@_state *state, const float *raw@features_argument@)
{
    const bool first = !state->started;
    bool good = true;
@last_values@    float sum = 0.0f;
    float linear;
    float readout;
    uint32_t input;
    uint32_t index;

    state->newest = (state->newest == 0u) ? (DELAY_LINE - 1u) : (state->newest - 1u);
    for (input = 0u; input < INPUTS; input++) {
        const float measured = (raw[input] - INPUT_OFFSETS[input]) / INPUT_SCALES[input];
        const bool is_good = (measured >= -MOST_NORMALISED) && (measured <= MOST_NORMALISED);
        const float value = is_good ? measured : (first ? RESTS[input] : state->inputs[input]);
        float delayed;

        good = good && is_good;
        if (first) {
            for (index = 0u; index < DELAY_LINE; index++) {
                state->delay_line[input][index] = value;
            }
        } else {
            state->delay_line[input][state->newest] = value;
        }
@keep_last@        state->inputs[input] = value;
        delayed = delay(state, input);
        state->paths[input] = @path@;
@settle@    }
    if ((!good) && (state->held_samples < UINT32_MAX)) {
        state->held_samples++;
    }
    if (first) {
@start_plays@        /* A stand-in is no start: the first good sample finds its own equilibrium. */
        state->started = good;
    }
@plays@    linear = BIAS + product(INPUT_WEIGHTS[0], state->paths[0]) + sum;
@more_paths@@creeps@    readout = @readout@;
@features@    return readout;
}
