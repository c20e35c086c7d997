    {
        const float path = state->paths[0];
        const float step = (path < last_paths[0]) ? (last_paths[0] - path) : (path - last_paths[0]);
        float law;
        float extra;
        float rising;
        float falling;

        state->step_size = first ? 0.0f : (state->step_size + product(GROWTH_FADING, step - state->step_size));
        law = growth_law(state->step_size);
        extra = product(path, APART[1] + product(path, APART[2]));
        extra = product(GROWTH_EXTRA, law) + product(path, APART[0] + extra);
        rising = not_negative(1.0f + product(GROWTH_RISING, path)) + product(GROWTH_SHARE, law);
        falling = not_negative(1.0f + product(GROWTH_FALLING, path)) + product(GROWTH_SHARE, law);
        for (index = 0u; index < PLAYS; index++) {
            const float low = path - not_negative(product(rising, PLAY_THRESHOLDS[index]) + extra);
            const float high = path + not_negative(product(falling, PLAY_THRESHOLDS[index]) + extra);
            const float bound = between(state->plays[index], low, high);
@follow@            sum = sum + product(PLAY_WEIGHTS[index], state->plays[index]);
        }
    }
