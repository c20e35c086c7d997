
/*
 * Window mode: every output comes from the last WINDOW feature vectors, from zero state. Before there are that many, the first one
 * stands for those that are missing.
 */
#define WINDOW @window@u

static float step_window(@name@_state *state, const int16_t *features)
{
    float correction = 0.0f;
    uint32_t slot;
    uint32_t age;
    uint32_t index;

    if (state->window_filled) {
        for (index = 0u; index < FEATURES; index++) {
            state->window[state->oldest][index] = features[index];
        }
        state->oldest = (state->oldest + 1u) % WINDOW;
    } else {
        for (slot = 0u; slot < WINDOW; slot++) {
            for (index = 0u; index < FEATURES; index++) {
                state->window[slot][index] = features[index];
            }
        }
        state->window_filled = true;
    }
    reset_network(state);
    for (age = 0u; age < WINDOW; age++) {
        slot = (state->oldest + age) % WINDOW;
        correction = step_network(state, state->window[slot]);
    }
    return correction;
}
