
/* Dead time of @dead_time@ samples: linear interpolation between the two samples around it. */
#define DELAY_WHOLE @whole@u
#define DELAY_LINE @line@u
static const float DELAY_FRACTION = @fraction@

static float delay(const @name@_state *state, uint32_t input)
{
    const float younger = state->delay_line[input][(state->newest + DELAY_WHOLE) % DELAY_LINE];
    const float older = state->delay_line[input][(state->newest + DELAY_WHOLE + 1u) % DELAY_LINE];

    return younger + product(DELAY_FRACTION, older - younger);
}
