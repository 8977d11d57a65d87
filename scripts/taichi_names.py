"""Makes docs/reference/taichi-names.md: the public names of Taichi 1.7.4, and their state here.

    taichi_names.py           checks; exits with 1 if the page is another
    taichi_names.py --write   writes the page

The state is asked of the package, and the test is a file of test/python that uses the name.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any

import tai as ti

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "reference" / "taichi-names.md"
TESTS = ROOT / "test" / "python"

# `dir` of each module and class, without the swizzles of Matrix and the keys of GUI.
NAMES = {
    "ti": """
        ArgPack BitpackedFields CRITICAL DEBUG DeviceCapability ERROR Field FieldsBuilder Format GUI
        INFO Layout Matrix MatrixField MatrixNdarray Mesh MeshInstance Ndarray SNode ScalarField
        ScalarNdarray Struct StructField TRACE TaichiAssertionError TaichiCompilationError
        TaichiNameError TaichiRuntimeError TaichiRuntimeTypeError TaichiSyntaxError TaichiTypeError
        Texture Vector VectorNdarray WARN abs acos activate amdgpu append arm64 asin assume_in_range
        atan2 atomic_add atomic_and atomic_max atomic_min atomic_mul atomic_or atomic_sub atomic_xor
        axes bit_cast bit_shr block_local cache_read_only cast ceil cos cpu cuda data_oriented
        dataclass deactivate deactivate_all_snodes dx11 dx12 eig exp extension f16 f32 f64 field
        float16 float32 float64 floor frexp func get_addr gles global_thread_idx gpu grouped
        hex_to_rgb i i16 i32 i64 i8 ij ijk ijkl ijl ik ikl il init int16 int32 int64 int8 is_active
        is_logging_effective j jk jkl jl k kernel kl l length log loop_config max mesh_local
        mesh_patch_idx metal min ndarray ndrange no_activate one opengl polar_decompose pow pyfunc
        randn random raw_div raw_mod real_func ref rescale_index reset rgb_to_hex root round rsqrt
        select set_logging_level sin solve sparse_matrix_builder sqrt static static_assert
        static_print stop_grad svd sym_eig sync tan tanh template u1 u16 u32 u64 u8 uint1 uint16
        uint32 uint64 uint8 vulkan x64 x86_64 zero
    """,
    "ti.math": """
        acos asin atan2 cconj cdiv ceil cexp cinv clamp clog clz cmul cos cpow cross csqrt degrees
        determinant distance dot e exp eye floor fract inf inverse isinf isnan ivec2 ivec3 ivec4
        length log log2 mat2 mat3 mat4 max min mix mod nan normalize pi popcnt pow radians reflect
        refract rot_by_axis rot_yaw_pitch_roll rotation2d rotation3d round scale sign sin smoothstep
        sqrt step tan tanh translate uvec2 uvec3 uvec4 vdir vec2 vec3 vec4
    """,
    "ti.ad": """
        FwdMode Tape clear_all_gradients grad_for grad_replaced no_grad
    """,
    "ti.types": """
        argpack f16 f32 f64 float16 float32 float64 i16 i32 i64 i8 int16 int32 int64 int8
        is_integral is_real is_signed is_tensor matrix ndarray ref rw_texture sparse_matrix_builder
        struct template texture u1 u16 u32 u64 u8 uint1 uint16 uint32 uint64 uint8 vector
    """,
    "ti.linalg": """
        LinearOperator MatrixFreeBICGSTAB MatrixFreeCG SparseCG SparseMatrix SparseMatrixBuilder
        SparseSolver
    """,
    "ti.sparse": """
        grid usage
    """,
    "ti.tools": """
        PLYWriter VideoManager imread imresize imshow imwrite write_vtk
    """,
    "ti.algorithms": """
        PrefixSumExecutor parallel_sort
    """,
    "ti.profiler": """
        CuptiMetric clear_kernel_profiler_info clear_scoped_profiler_info
        collect_kernel_profiler_metrics get_kernel_profiler_total_time get_predefined_cupti_metrics
        print_kernel_profiler_info print_memory_profiler_info print_scoped_profiler_info
        query_kernel_profiler_info set_kernel_profiler_metrics set_kernel_profiler_toolkit
    """,
    "Matrix": """
        all any cast cols cross determinant diag dot field fill get_shape identity inverse max min
        ndarray norm norm_inv norm_sqr normalized one outer_product rows sum to_list to_numpy trace
        transpose unit zero
    """,
    "ScalarField": """
        copy_from dtype fill from_numpy from_paddle from_torch parent shape snode to_numpy to_paddle
        to_torch
    """,
    "MatrixField": """
        copy_from dtype fill from_numpy from_paddle from_torch get_scalar_field parent shape snode
        to_numpy to_paddle to_torch
    """,
    "StructField": """
        copy_from dtype fill from_numpy from_paddle from_torch get_member_field keys parent shape
        snode to_numpy to_paddle to_torch
    """,
    "Ndarray": """
        copy_from element_shape fill get_type
    """,
    "SNode": """
        bitmasked deactivate_all dense dynamic lazy_dual lazy_grad parent place pointer quant_array
        shape
    """,
    "Struct": """
        entries field items keys methods to_dict
    """,
    "FieldsBuilder": """
        bitmasked deactivate_all dense dynamic finalize lazy_dual lazy_grad place pointer
        quant_array
    """,
    "ti.ui": """
        ALT BACKSPACE CAPSLOCK CTRL Camera DOWN ESCAPE LEFT LMB MMB PRESS ProjectionMode RELEASE
        RETURN RIGHT RMB SHIFT SPACE Scene TAB UP Window make_camera
    """,
    "ti.ui.Window": """
        GUI destroy fps_limit get_canvas get_cursor_pos get_depth_buffer
        get_depth_buffer_as_numpy get_event get_events get_gui get_image_buffer_as_numpy get_scene
        get_window_shape is_pressed running save_image show write_image
    """,
    "ti.ui.Camera": """
        bottom curr_lookat curr_position curr_up fov get_projection_matrix get_view_matrix left
        lookat position projection_mode right top track_user_inputs up z_far z_near
    """,
    "ti.ui.Scene": """
        ambient_light lines mesh mesh_instance particles point_light set_camera
    """,
    "GUI": """
        arrow arrow_field arrows button circle circles clear close contour cook_image fps_limit
        get_bool_environ get_cursor_pos get_event get_events get_image get_key_event has_key_event
        is_pressed label line lines point_field rect running set_image show slider text triangle
        triangles vector_field
    """,
}

# Remarks on names with another meaning here, and on names without effect.
REMARKS = {
    "ti.BitpackedFields": "the class is there; placing one is refused",
    "ti.block_local": "a hint without effect",
    "ti.cache_read_only": "a hint without effect",
    "ti.no_activate": "a promise without effect: cells that are active are seen anyway",
    "ti.assume_in_range": "a promise, which is not checked",
    "ti.loop_unique": "a promise, which is not checked",
    "ti.amdgpu": "a warning, then `ti.gpu`",
    "ti.arm64": "taken as `ti.cpu`",
    "ti.dx11": "a warning, then `ti.gpu`",
    "ti.gles": "a warning, then `ti.gpu`",
    "ti.metal": "a warning, then `ti.gpu`",
    "ti.opengl": "a warning, then `ti.gpu`",
    "ti.vulkan": "a warning, then `ti.gpu`",
    "ti.real_func": "as `ti.func`: compiled into its callers; recursion is refused",
    "ti.GUI": "opens a window where a display is; draws into files elsewhere",
    "ti.stop_grad": "of a value; Taichi's takes a field",
    "ti.eig": "of 2×2 matrices",
    "ti.solve": "with pivots, of any small size",
    "ti.init": "options of Taichi: [their page](taichi-options.md)",
    "ti.get_addr": "in kernels of the CPU",
    "ti.ad.Tape": "restores overwritten values; has budgets, checks, replay",
    "ti.ad.FwdMode": "several seeds at once",
    "ti.types.quant": "refused",
}  # fmt: skip
# Names that are missing on purpose, with the reason, where the package itself names none.
MISSING = {
    "dx12": "no such target",
    "dtype": "that of a member: `field.a.dtype`",
    "DeviceCapability Format": "of targets that there are not",
    "global_thread_idx": "loops are made parallel by the compiler; use the loop variable",
    "write_vtk": "write arrays with a package for VTK, such as meshio",
    "CuptiMetric collect_kernel_profiler_metrics get_predefined_cupti_metrics "
    "set_kernel_profiler_metrics": "use Nsight Compute, which sees kernels by name",
    "get_type": "`dtype` and `shape` say it",
    "entries methods": "`to_dict()` and `keys`",
    "cook_image get_bool_environ": "of Taichi's own implementation",
    "is_tensor": "ask `ti.types` for what is meant: `is_real`, `is_integral`",
    "write_image": "`save_image`, as in Taichi 1.7",
    "get_depth_buffer": "`field.from_numpy(window.get_depth_buffer_as_numpy())`",
    "texture rw_texture": "read and write a field or array",
    "ref": "return what a function changes, or pass the field as `ti.template()`",
    "argpack": "pass a struct: `ti.types.struct(…)`",
    "from_paddle to_paddle": "Paddle is not supported: use NumPy, torch or DLPack",
    "quant_array": "quantised types are not built in",
    "PLYWriter": "write positions with `numpy.savetxt`, or with a package for PLY",
}


def names() -> Iterator[tuple[str, str]]:
    for owner, listed in NAMES.items():
        for name in sorted(listed.split(), key=str.lower):
            yield owner, name


def full(owner: str, name: str) -> str:
    return f"{owner}.{name}"


@cache
def samples() -> dict[str, Any]:
    """An object of each class, since instances have attributes that their classes lack."""
    ti.init()
    return {
        "Matrix": ti.Matrix([[1.0, 2.0], [3.0, 4.0]]),
        "ScalarField": ti.field(ti.f32, shape=2),
        "MatrixField": ti.Vector.field(2, ti.f32, shape=2),
        "StructField": ti.Struct.field({"a": ti.f32}, shape=2),
        "Ndarray": ti.ndarray(ti.f32, shape=2),
        "SNode": ti.root.dense(ti.i, 2),
        "Struct": ti.Struct(a=1),
        "FieldsBuilder": ti.FieldsBuilder(),
        "GUI": ti.GUI,
    }


def found(owner: str, name: str) -> bool:
    """Whether the package has the name."""
    if owner == "ti":
        return hasattr(ti, name)
    if owner.startswith("ti."):
        return hasattr(attrgetter(owner.removeprefix("ti."))(ti), name)
    return hasattr(samples()[owner], name)


@cache
def texts() -> dict[str, str]:
    """The text of each test."""
    files = sorted(TESTS.rglob("test_*.py"))
    return {path.relative_to(ROOT).as_posix(): path.read_text() for path in files}


def test_of(owner: str, name: str) -> str:
    """A test that uses the name, if there is one."""
    if owner == "ti.math":
        pattern = re.compile(rf"\b(?:tm|math)\.{re.escape(name)}\b|\"{re.escape(name)}\"")
    elif owner.startswith("ti") and owner.count(".") < 2:
        pattern = re.compile(rf"\b{re.escape(full(owner, name))}\b")
    else:
        pattern = re.compile(rf"\.{re.escape(name)}\b")
    using = [path for path, text in texts().items() if path not in NOT_BY and pattern.search(text)]
    # The smallest file is the most particular one.
    return min(using, key=lambda path: (len(texts()[path]), path), default="")


# A file that only lists names.
NOT_BY = ("test/python/tools/test_api.py",)


def remark(owner: str, name: str, there: bool) -> str:
    if there:
        return REMARKS.get(full(owner, name), "")
    for listed, reason in MISSING.items():
        if name in listed.split():
            return reason
    reason = ti._NOT_YET.get(name, "") if owner == "ti" else ""
    return reason


def page() -> str:
    there = {(owner, name): found(owner, name) for owner, name in names()}
    count = sum(there.values())
    lines = [
        "# Names of Taichi",
        "",
        f"The public names of Taichi 1.7.4: {count} of {len(there)} are here, under the same "
        "name. Made by `scripts/taichi_names.py --write`, which asks the package; the last column "
        "is a test that uses the name.",
        "",
        "Modules that are missing: `ti.simt`, `ti.graph`, `ti.aot`, `ti.experimental`. "
        "The error says what takes their place.",
    ]  # fmt: skip
    owner = ""
    for (at, name), yes in there.items():
        if at != owner:
            owner = at
            lines += [
                "",
                f"## {owner}",
                "",
                "| name | state | remark | test |",
                "|---|---|---|---|",
            ]
        test = test_of(at, name) if yes else ""
        shown = f"[{Path(test).stem}](../../{test})" if test else ""
        state = "yes" if yes else "no"
        lines.append(f"| `{name}` | {state} | {remark(at, name, yes)} | {shown} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true")
    if parser.parse_args().write:
        PAGE.write_text(page())
        return 0
    if PAGE.read_text() != page():
        print(f"{PAGE.relative_to(ROOT)} is not up to date: scripts/taichi_names.py --write")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
