    if (!first) {
        path = state->slewed + between(path - state->slewed, -SLEW_FALL, SLEW_RISE);
    }
    state->slewed = path;
