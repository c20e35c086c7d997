            const float missing = bound - state->plays[index];
            const float followed = (missing > 0.0f) ? (state->plays[index] + between(follow(missing), 0.0f, missing))
                                                    : (state->plays[index] - between(follow(-missing), 0.0f, -missing));

            state->plays[index] = first ? bound : followed;
