"""Which tests a run on a device leaves out, and which fail there, each with its reason.

A test that is listed as failing is run: when it passes, or is there no more, the list is wrong,
and that is a failure. Tests that need something of the machine say so themselves, by a skip.
"""

ALL = "*"  # of a module

# Nothing in them depends on the target, or they choose it themselves: one run does.
ONE_RUN_DOES = {
    "test_cuda_floors": {ALL: "programs in CUDA C++"},
    "test_device_lists": {ALL: "chooses the target itself"},
    "test_emulated_blocks": {ALL: "chooses the target itself"},
    "test_gpu_benchmark": {ALL: "chooses the target itself"},
    "test_taichi_names": {
        "test_names_are_there": "looks at names alone",
        "test_field_attributes": "looks at names alone",
        "test_inner_modules_are_the_same_under_the_other_name": "looks at names alone",
        "test_no_alias_without_being_asked": "looks at names alone",
    },
}  # fmt: skip

# On the emulated device and on GPUs.
FAILS_ON_A_DEVICE = {
    "test_adjoint_flags": {
        "test_one_body_of_ten": "a device visits cells whose adjoints are zero, too",
        "test_what_visits_everything": "a device visits cells whose adjoints are zero, too",
        "test_gathered_adjoints_visit_what_lies_around": "a device visits all active cells",
    },
    "test_argument_gradients": {
        "test_a_reduction_over_many_iterations": "looks for the loops of the CPU",
    },
    "test_plain_replays": {
        "test_same_bits": "direct replays, which it counts, are of the CPU",
        "test_says_how_many": "direct replays, which it counts, are of the CPU",
        "test_what_fails": "direct replays, which it counts, are of the CPU",
    },
    "test_sparse_errors": {
        "test_out_of_memory_in_a_kernel": "cells have their memory from the start on a device",
    },
}

# On GPUs alone. These would end the process and are not run there.
ENDS_THE_PROCESS_ON_A_GPU = {
    "test_sparse_api": {
        "test_addresses_hold_the_elements": "the host cannot follow addresses of a GPU",
    },
}


def reason(table, item):
    """Why a test is in the table, or None."""
    tests = table.get(item.module.__name__, {})
    return tests.get(item.originalname, tests.get(ALL))


def missing(modules):
    """What the tables list and these modules do not have."""
    return [
        f"{module}.{test}"
        for table in (ONE_RUN_DOES, FAILS_ON_A_DEVICE, ENDS_THE_PROCESS_ON_A_GPU)
        for module, tests in table.items()
        for test in tests
        if module in modules and test != ALL and not hasattr(modules[module], test)
    ]
