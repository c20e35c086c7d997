        for (index = 0u; index < PLAYS; index++) {
            state->plays[index] = 0.0f;
        }
