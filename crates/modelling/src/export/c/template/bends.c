    uint32_t index;

    for (index = 0u; index < BENDS; index++) {
        const float beyond = linear - BEND_POINTS[index];

        if (beyond > 0.0f) {
            value = value + product(BENDS_OF_SLOPE[index], beyond);
        }
    }
