        if (first) {
            last_paths[input] = state->paths[input];
        }
