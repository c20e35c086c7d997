
/* Dead time of @dead_time@ samples: linear interpolation between the two samples around it. */
#define DELAY_WHOLE @whole@u
#define DELAY_LINE @line@u
static const float DELAY_FRACTION = @fraction@

static float delay(@name@_state *state, float input)
{
    float younger;
    float older;

    state->newest = (state->newest == 0u) ? (DELAY_LINE - 1u) : (state->newest - 1u);
    state->delay_line[state->newest] = input;
    younger = state->delay_line[(state->newest + DELAY_WHOLE) % DELAY_LINE];
    older = state->delay_line[(state->newest + DELAY_WHOLE + 1u) % DELAY_LINE];
    return younger + product(DELAY_FRACTION, older - younger);
}
