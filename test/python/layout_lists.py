"""Tests that run on dense layouts only, each with its reason.

All others give the same results on sparse ones: `make test-layouts`.
"""

# Tests that are about layouts, memory or other processes themselves, and say which.
ABOUT_LAYOUTS = {
    "test_api", "test_benchmark_scenes", "test_block_rows", "test_errors", "test_examples",
    "test_explain", "test_gui", "test_interop", "test_kernel_names", "test_lazy_names",
    "test_random_kernels", "test_readme", "test_skips", "test_sparse_api", "test_sparse_cells",
    "test_sparse_errors", "test_sparse_model", "test_taichi_names", "test_trust", "test_tutorial",
    "test_volumes",
}  # fmt: skip

FORM = "asks for a form that dense trees alone have"
CELLS = "loops over active cells are not known before the launch"
LISTS = "kernels that make lists of cells come between"
SHARES = "memory of sparse fields cannot be shared"
# No tape keeps the overwritten elements, or the gradient within a host function would need lists
# that it has changed.
REFUSED = "refused on sparse layouts, for another reason"
TANGENTS = "tangents of cells that the sweep brings back are refused"
ONE_TREE = "the text names one dense tree"

DENSE_ALONE = {
    "test_bounds": {"test_what_is_known_costs_nothing": CELLS, "test_wrong_guard": CELLS},
    "test_custom_gradients": {"test_the_gradient_of_a_kernel_inside_of_the_gradient": REFUSED},
    "test_devices": {"test_out_of_memory_names_the_trees": ONE_TREE},
    "test_fused_launches": {
        "test_bits_are_those_of_single_launches": FORM,
        "test_rows_that_are_written_out_are_known": FORM,
        "test_threads_that_go_on_with_their_elements_do_not_wait": FORM,
    },
    "test_launch_leads": {
        "test_a_shared_field_shows_each_step": SHARES,
        "test_training_with_momentum": FORM,
    },
    "test_lost_gradients": {"test_what_is_overwritten_in_between": CELLS},
    "test_overwritten_gradients": {
        "test_forward_over_reverse": TANGENTS,
        "test_whoever_looks_sees_zeros": SHARES,
    },
    "test_plain_replays": {
        "test_same_bits": FORM,
        "test_says_how_many": FORM,
        "test_what_fails": FORM,
    },
    "test_profiler": {"test_rows": LISTS, "test_tables": LISTS, "test_trace": LISTS},
    "test_recorded_again": {
        "test_addresses_of_what_is_kept_stay": FORM,
        "test_arguments_that_change_each_time": FORM,
        "test_memory_that_is_shared": FORM,
        "test_the_step_is_part_of_the_next_recording": FORM,
        "test_training": FORM,
        "test_two_tapes_and_the_sweep_of_one_within_the_other": FORM,
        "test_values_that_are_overwritten": FORM,
    },
    "test_returned_tangents": {
        "test_a_serial_chain_of_returned_numbers": TANGENTS,
        "test_arithmetic_of_python": TANGENTS,
        "test_vectors_matrices_and_components": TANGENTS,
    },
    "test_stored_outputs": {
        "test_a_function_with_its_own_gradient": FORM,
        "test_a_gradient_launched_by_hand_after_a_tape": FORM,
        "test_a_layer_loads_its_output": FORM,
        "test_a_slot_that_is_used_again_is_computed_again": FORM,
        "test_an_output_that_the_kernel_reads_again": FORM,
        "test_half_a_slot_may_be_stored_by_another_launch": FORM,
        "test_launches_that_take": FORM,
        "test_outputs_that_are_overwritten_within_the_tape": FORM,
        "test_outputs_that_nobody_else_reads_may_change_after_the_tape": FORM,
        "test_results_of_loops": FORM,
        "test_vectors_and_their_components": FORM,
        "test_what_is_computed_again_keeps_no_more_than_it_did": FORM,
    },
    "test_tiles": {
        "test_fields_that_share_cells": FORM,
        "test_lines_and_boxes": FORM,
        "test_stores_that_are_left_out_keep_what_was_there": FORM,
        "test_sweeps_around_the_borders": FORM,
        "test_sweeps_inside_of_the_borders": FORM,
    },
}


def missing(modules):
    """Entries of the lists that these modules do not have."""
    return [
        f"{module}.{test}"
        for module, tests in DENSE_ALONE.items()
        for test in tests
        if module in modules and not hasattr(modules[module], test)
    ]
