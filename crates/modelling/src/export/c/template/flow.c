    if (!first) {
        const float missing = path - state->flowed;

        path = state->flowed + product((missing > 0.0f) ? FLOW_FILL : FLOW_VENT, missing);
    }
    state->flowed = path;
