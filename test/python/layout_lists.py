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

# Linear solvers take all elements of a vector, so they refuse sparse fields.
SOLVES = "ti.linalg refuses sparse fields"
# L-BFGS, Gauss-Newton and SciPy's methods multiply vectors of all elements.
MINIMIZES = "minimisers refuse sparse fields"
# solve_to compares runs in other types, but the type of a sparse field cannot be changed.
TYPES = "the type of a sparse field cannot be changed"

# Files whose tests are dense for one reason: most of them call what refuses sparse fields.
DENSE_FILES = {
    "test_hvp_of_solves": SOLVES,
    "test_implicit": SOLVES,
    "test_linear_solvers": SOLVES,
    "test_minimizers": MINIMIZES,
    "test_solver_iterations": SOLVES,
    "test_solver_table": SOLVES,
}

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
    "test_loops_that_end": {
        "test_the_adjoint_of_a_solve_begins_where_the_last_one_ended": SOLVES,
    },
    "test_lost_detours": {
        "test_a_view_of_an_earlier_program": SHARES,
        "test_forward_mode": SHARES,
        "test_it_is_said_once_with_the_line": SHARES,
        "test_nothing_is_said_where_nothing_is_lost": SHARES,
        "test_views_that_are_older_than_the_tape": SHARES,
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
    "test_rare_refusals": {"test_rare_mistakes_on_the_host": SOLVES},
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
    "test_singular_adjoints": {
        "test_gradients_of_singular_systems": SOLVES,
    },
    "test_solve_to": {
        "test_a_function_that_makes_the_program": TYPES,
        "test_a_gradient_that_loses_more_than_the_loss": TYPES,
        "test_again_in_the_chosen_modes": TYPES,
        "test_an_error_inside_leaves_the_types": TYPES,
        "test_parts_name_the_lines": TYPES,
        "test_room_names_the_modes_that_fail": TYPES,
        "test_room_that_no_mode_fills": TYPES,
        "test_solvers_that_stop_too_early": TYPES,
        "test_solvers_with_tolerances_of_their_own": TYPES,
        "test_structs_matrices_and_returned_numbers": TYPES,
        "test_the_error_that_was_asked_for": TYPES,
        "test_the_report_bounds_the_effect_of_solvers": TYPES,
        "test_tolerance_of_a_solver": TYPES,
    },
    "test_solve_to_memory": {
        "test_a_budget_that_holds_everything": TYPES,
        "test_a_small_tape_keeps_everything": TYPES,
        "test_f64_where_it_is_faster": TYPES,
        "test_snapshots_where_they_are_faster": TYPES,
    },
    "test_solve_to_slopes": {
        "test_a_slope_that_one_step_does_not_show": TYPES,
        "test_an_error_below_what_near_inputs_show": TYPES,
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
