    for (index = 0u; index < PLAYS; index++) {
        state->plays[index] = play(PLAY_THRESHOLDS[index], state->paths[@play_input@], state->plays[index]);
        sum = sum + product(PLAY_WEIGHTS[index], state->plays[index]);
    }
