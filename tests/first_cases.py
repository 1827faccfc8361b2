"""Parametrised tests of which the fast tests take the first cases only, because each compiles.

The other cases repeat the same check with other numbers, and `make test-slow` takes them, too.
"""

from collections.abc import Sequence

import pytest

# Number of fast cases by the name of the test.
FAST = {
    "test_a_constant_brain_senses_nothing": 2,
    "test_a_population_around_an_individual_keeps_it": 3,
    "test_a_search_improves_with_finite_genes": 4,
    "test_a_state_survives_conversion_to_arrays": 3,
    "test_a_wrong_cluster_is_refused": 2,
    "test_accelerations_equal_mujocos": 1,
    "test_accepted_attributes_move_as_in_mujoco": 12,
    "test_any_number_of_batch_axes_agrees_with_jax": 3,
    "test_bits_do_not_depend_on_the_number_of_individuals": 3,
    "test_calls_have_the_bits_of_a_population": 1,
    "test_delay_interpolates_between_samples": 2,
    "test_derivatives_of_loops_equal_those_of_jax": 1,
    "test_displaced_volume_and_moment_are_exact": 3,
    "test_displaced_volume_and_moment_in_any_position": 3,
    "test_distance_is_exact": 2,
    "test_each_individual_writes_to_its_own_places": 2,
    "test_each_posture_is_held_for_its_period": 3,
    "test_fault_is_found_in_its_part_and_pass": 2,
    "test_frequency_and_lag_equal_simulation": 1,
    "test_gaps_are_distances": 3,
    "test_invalid_classes_of_ones_own_are_rejected": 8,
    "test_invalid_situations_and_lights_are_rejected": 5,
    "test_legs_that_are_not_coupled_get_a_warning": 1,
    "test_metrics_have_their_names": 1,
    "test_multipliers_predict_the_decay_of_a_perturbation": 1,
    "test_only_the_named_part_evolves": 1,
    "test_pairs_left_out_never_meet": 1,
    "test_random_numbers_equal_those_of_jax_bit_for_bit": 3,
    "test_random_trees_accelerate_as_in_mujoco": 1,
    "test_return_values_of_an_own_strategy_are_checked": 5,
    "test_terminal_velocity_equals_the_closed_form": 2,
    "test_the_rhythm_follows_its_equations": 1,
    "test_unused_genes_are_zero_in_tidy_plans": 2,
    "test_up_direction_is_converted": 1,
    "test_vmap_and_derivatives_agree_with_jax": 1,
    "test_wrong_input_is_one_line_and_exit_code_2": 2,
}


def mark_others(items: Sequence[pytest.Item]) -> None:
    """Mark all further cases as slow."""
    seen: dict[str, int] = {}
    for item in items:
        name = getattr(item, "originalname", None) or item.name
        if name in FAST and item.get_closest_marker("slow") is None:
            place = f"{item.path}::{name}"
            seen[place] = seen.get(place, 0) + 1
            if seen[place] > FAST[name]:
                item.add_marker(pytest.mark.slow)
