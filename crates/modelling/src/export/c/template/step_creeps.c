    for (index = 0u; index < CREEPS; index++) {
        const float last = state->creeps[index];

        state->creeps[index] = first ? sum : (last + product(CREEP_COEFFICIENTS[index], sum - last));
        linear = linear + product(CREEP_WEIGHTS[index], state->creeps[index]);
    }
