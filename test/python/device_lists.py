"""Tests that a run on a device leaves out, and tests that fail there, each with its reason.

A test that is listed as failing is run: when it passes, or is there no more, the list is wrong,
and that is a failure. Tests that need something of the machine say so themselves, by a skip.
"""

ALL = "*"  # of a module

NO_KERNEL = "no kernel runs in it, and no field is read or written"
NAMES = "looks at names alone"
SOURCES = "looks at the sources"
CPU = "is of the CPU"
CHOOSES = "chooses the target itself"
RANKS = "its ranks run on the CPU; benchmarks/gpu/mesh_gpus.py has those of GPUs"

# Nothing in them depends on the target, or they choose it themselves: one run does.
ONE_RUN_DOES = {
    "test_ad_memory": {"test_options_that_make_no_sense": NO_KERNEL},
    "test_api": {
        "test_names_are_there": NAMES,
        "test_docstrings": NAMES,
        "test_every_method_of_the_api_surface": NAMES,
        "test_missing_names_say_so": NAMES,
        "test_import_loads_neither_the_compiler_nor_plotting": NAMES,
        "test_runtime_shim": NO_KERNEL,
    },
    "test_argument_gradients": {
        "test_what_cannot_be_a_variable": NO_KERNEL,
        "test_values_with_a_gradient_are_no_constants": NO_KERNEL,
        "test_matrices_are_not_computed_with_in_python": NO_KERNEL,
    },
    "test_array_gradients": {
        "test_the_gradient_cannot_be_replaced": NO_KERNEL,
        "test_needs_grad_of_whole_numbers": NO_KERNEL,
        "test_an_array_has_a_gradient_of_its_kind": NO_KERNEL,
        "test_a_loss_of_several_numbers": NO_KERNEL,
    },
    "test_bench_error": {ALL: CHOOSES},
    "test_compile_progress": {ALL: "of the time that one compilation takes"},
    "test_conditional_copies": {"test_on_one_thread_it_is_in_order": CPU},
    "test_cuda_floors": {ALL: "programs in CUDA C++"},
    "test_device_lists": {ALL: CHOOSES},
    "test_sanitizer": {ALL: CHOOSES},
    "test_same_bits": {ALL: CHOOSES},
    "test_one_order": {ALL: CHOOSES},
    "test_serial_work": {"test_a_cpu_has_no_such_threads": CHOOSES},
    "test_emulated_blocks": {ALL: CHOOSES},
    "test_explain": {"test_loops_of_threads_and_of_one_thread": CPU},
    "test_forward_mode": {"test_every_scalar_rule_is_tested": NAMES},
    "test_fixed_rows": {ALL: CHOOSES},
    "test_gpu_benchmark": {ALL: CHOOSES},
    "test_huge_bodies": {
        "test_code_of_hundreds_of_loops_is_in_parts": CPU,
        "test_code_of_huge_blocks_is_in_parts": CPU,
        "test_huge_loops_call_a_function_once_for_each_call": CPU,
    },
    "test_launch_sequences": {ALL: CHOOSES},
    "test_linear_solvers": {
        "test_incomplete_cholesky": CPU,
        "test_matrices_without_an_incomplete_factor": CPU,
        "test_on_a_device": CHOOSES,
    },
    "test_interrupted_steps": {ALL: "of the steps of the package, which no target changes"},
    "test_interrupts": {ALL: "of kernels on the CPU; those of a device: test_device_interrupts"},
    "test_lazy_names": {ALL: NAMES},
    "test_looped_copies": {"test_loops_that_are_no_sum": CPU},
    "test_matrices": {
        "test_in_python": "matrices of Python, which no kernel computes",
        "test_python_matrices": "matrices of Python, which no kernel computes",
    },
    "test_one_thread": {ALL: CPU},
    "test_other_iterations": {"test_one_thread_has_an_order": CPU},
    "test_perf_map": {ALL: CPU},
    "test_random_kernels": {"test_a_few_dozen": "the targets of a GPU are a step of make test-gpu"},
    "test_particles": {ALL: RANKS},
    "test_rank_ensembles": {ALL: RANKS},
    "test_ranks": {ALL: RANKS},
    "test_refused_ranks": {ALL: RANKS},
    "test_reliability": {ALL: "the bars that a device can run are a step of make test-gpu"},
    "test_rooms": {ALL: SOURCES},
    "test_running_launches": {
        ALL: "its kernel waits for the host, which waits for what a device has begun",
    },
    "test_shadow": {ALL: CPU},
    "test_shared_updates": {"test_one_thread_runs_in_order": CPU},
    "test_strict": {"test_a_processor_without_fused_operations": CPU},
    "test_stripped_attributes": {
        "test_modes_stay": CPU,
        "test_modes_stay_on_a_device": CHOOSES,
        "test_results_stay_on_a_device": CHOOSES,
    },
    "test_taichi_names": {
        "test_names_are_there": NAMES,
        "test_field_attributes": NAMES,
        "test_inner_modules_are_the_same_under_the_other_name": NAMES,
        "test_no_alias_without_being_asked": NAMES,
    },
    "test_tidy": {ALL: SOURCES},
    "test_vector_functions": {ALL: CPU},
    "test_worked_examples": {ALL: SOURCES},
}

# On the emulated device and on GPUs.
FAILS_ON_A_DEVICE = {
    "test_ad_health": {
        "test_a_field_that_is_not_finite_at_the_start_is_named": "no loss is waited for",
        "test_a_kernel_that_leaves_what_is_not_finite_is_named": "no loss is waited for",
        "test_a_kernel_that_reads_a_gradient_as_data_is_named_for_its_own_mistake": (
            "no loss is waited for"
        ),
        "test_a_kernel_without_suspects_names_none": "no loss is waited for",
    },
    "test_zero_adjoints": {
        "test_one_body_of_ten": "a device visits cells whose adjoints are zero, too",
        "test_what_visits_everything": "a device visits cells whose adjoints are zero, too",
        "test_gathered_adjoints_visit_what_lies_around": "a device visits all active cells",
    },
    "test_zero_blocks": {
        "test_blocks_have_the_same_bits": "a device visits blocks whose adjoints are zero, too",
    },
    "test_argument_gradients": {
        "test_a_reduction_over_many_iterations": "looks for the loops of the CPU",
    },
    "test_lost_detours": {"test_forward_mode": "NumPy has no arrays of a GPU"},
    "test_plain_replays": {
        "test_same_bits": "direct replays, which it counts, are of the CPU",
        "test_says_how_many": "direct replays, which it counts, are of the CPU",
        "test_what_fails": "direct replays, which it counts, are of the CPU",
    },
    "test_program_limits": {
        "test_reports_have_names_that_are_not_english": "counts launches of kernels on the CPU",
    },
    "test_sparse_errors": {
        "test_out_of_memory_in_a_kernel": "cells have their memory from the start on a device",
    },
}

# On GPUs alone, and not run there: they would end the process, or wait for refused threads.
NOT_RUN_ON_A_GPU = {
    "test_device_interrupts": {
        "test_a_kernel_is_interrupted": "endless iterations of a GPU are not ended yet",
    },
    "test_interrupted_copies": dict.fromkeys(
        [
            "test_a_replay_that_does_not_reach_its_end", "test_a_write_stops_before_its_end",
            "test_gradients_on_their_way_to_zero", "test_values_that_a_sweep_puts_back",
        ],
        "a GPU is done before the signal comes",
    ),
    "test_numpy_protocols": dict.fromkeys(
        [
            "test_how_a_gpu_describes_members_of_structs_and_parts_of_trees",
            "test_how_a_gpu_describes_the_memory_of_a_field",
        ],
        "NumPy cannot follow addresses of a GPU",
    ),
    "test_stripped_attributes": {
        "test_results_stay": "attributes between passes of device code may not be lost yet",
    },
    "test_sparse_api": {
        "test_addresses_hold_the_elements": "the host cannot follow addresses of a GPU",
    },
    "test_thread_tapes": dict.fromkeys(
        [
            "test_a_thread_that_ends_with_its_tape_open", "test_check_in_threads",
            "test_gradients_of_many_threads", "test_one_loss_for_two_tapes",
            "test_one_thread_compiles_while_others_sweep", "test_one_variable_for_two_tapes",
            "test_tapes_that_add_to_one_gradient", "test_tapes_that_read_one_field",
            "test_tapes_that_want_one_gradient", "test_variables_and_arrays_of_threads",
        ],
        "a GPU records one tape at a time",
    ),
}  # fmt: skip


def reason(table, item):
    """Why a test is in the table, or None."""
    tests = table.get(item.module.__name__, {})
    return tests.get(item.originalname, tests.get(ALL))


def missing(modules):
    """Entries of the tables that these modules do not have."""
    return [
        f"{module}.{test}"
        for table in (ONE_RUN_DOES, FAILS_ON_A_DEVICE, NOT_RUN_ON_A_GPU)
        for module, tests in table.items()
        for test in tests
        if module in modules and test != ALL and not hasattr(modules[module], test)
    ]
