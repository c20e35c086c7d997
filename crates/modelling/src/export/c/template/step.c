
/* Output channel, and the half-width of the stick band in normalised output. */
static const float OUTPUT_OFFSET = @offset@
static const float OUTPUT_SCALE = @scale@
static const float STICK_BAND = @band@

void @name@_reset(@name@_state *state)
{
    /* The first step sets what is not set here. */
    state->started = false;
    state->held_samples = 0u;
    state->newest = 0u;
    state->has_output = false;
    state->output = 0.0f;
@reset_network@}

float @name@_step(@name@_state *state, @input_argument@)
{
@features@    const float readout = step_front_end(state, @input_address@@features_argument@);
    const float correction = @correction@;
    const float normalised = readout + correction;
    const float moved = normalised - state->output;

    if ((!state->has_output) || (moved > STICK_BAND) || (-moved > STICK_BAND)) {
        state->output = normalised;
        state->has_output = true;
    }
    return OUTPUT_OFFSET + product(OUTPUT_SCALE, state->output);
}
