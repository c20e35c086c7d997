    if (!first) {
        const float missing = path - state->flowed;

        path = (missing > 0.0f) ? (state->flowed + between(fill(missing), 0.0f, missing))
                                : (state->flowed - between(vent(-missing), 0.0f, -missing));
    }
    state->flowed = path;
