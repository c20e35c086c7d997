    for (input = 1u; input < INPUTS; input++) {
        linear = linear + product(INPUT_WEIGHTS[input], state->paths[input]);
    }
