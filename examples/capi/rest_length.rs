//! A rest length found by gradient descent, in Rust.
//!
//!     rustc -L <tai>/lib -C link-arg=-Wl,-rpath,<tai>/lib rest_length.rs
//!     ./rest_length rest_length.mlir
//!
//! The declarations below are those of tai-c/Tai.h that the program calls. `bindgen` makes all of
//! them: `bindgen tai-c/Tai.h --allowlist-item '[Tt]ai.*' -- -DTAI_PLAIN_FUNCTIONS -I <tai>/include`.

use std::ffi::{c_char, c_int, c_void, CStr, CString};
use std::ptr::{null, null_mut};

type Handle = *mut c_void; // TaiContext, TaiProgram, TaiField, TaiKernel, TaiTape

#[repr(C)]
struct TaiError {
    status: c_int,
    message: *const c_char,
    file: *const c_char,
    line: c_int,
    column: c_int,
    diagnostics: *const c_char,
}

#[link(name = "tai")]
extern "C" {
    fn taiContextCreate() -> Handle;
    fn taiContextDestroy(context: Handle);
    fn taiContextLastError(context: Handle) -> TaiError;
    fn taiProgramLoadFile(context: Handle, path: *const c_char, program: *mut Handle) -> c_int;
    fn taiProgramGetKernel(program: Handle, name: *const c_char, kernel: *mut Handle) -> c_int;
    fn taiContextFindField(context: Handle, name: *const c_char, field: *mut Handle) -> c_int;
    fn taiFieldGetAdjoint(field: Handle, adjoint: *mut Handle) -> c_int;
    fn taiFieldWriteF64(field: Handle, at: *const i64, component: i64, value: f64) -> c_int;
    fn taiFieldReadF64(field: Handle, at: *const i64, component: i64, value: *mut f64) -> c_int;
    fn taiTapeBegin(context: Handle, loss: Handle, clear: bool, tape: *mut Handle) -> c_int;
    fn taiTapeEnd(tape: Handle) -> c_int;
    fn taiTapeBackward(tape: Handle) -> c_int;
    fn taiTapeDestroy(tape: Handle);
    fn taiKernelLaunch(kernel: Handle, args: *const u64, slots: i64, results: *mut u64) -> c_int;
}

/// A context, which owns all other handles.
struct Tai(Handle);

impl Tai {
    fn check(&self, status: c_int) {
        if status != 0 {
            let error = unsafe { taiContextLastError(self.0) };
            eprint!("{}", unsafe { CStr::from_ptr(error.diagnostics) }.to_string_lossy());
            std::process::exit(1);
        }
    }

    /// The handle that a function stores.
    fn get(&self, call: impl FnOnce(*mut Handle) -> c_int) -> Handle {
        let mut handle = null_mut();
        self.check(call(&mut handle));
        handle
    }

    fn read(&self, field: Handle) -> f64 {
        let mut value = 0.0;
        self.check(unsafe { taiFieldReadF64(field, null(), 0, &mut value) });
        value
    }
}

impl Drop for Tai {
    fn drop(&mut self) {
        unsafe { taiContextDestroy(self.0) }
    }
}

fn main() {
    let path = CString::new(std::env::args().nth(1).unwrap_or_default()).unwrap();
    let name = |text: &str| CString::new(text).unwrap();
    unsafe {
        let tai = Tai(taiContextCreate());
        let program = tai.get(|to| taiProgramLoadFile(tai.0, path.as_ptr(), to));
        let swing = tai.get(|to| taiProgramGetKernel(program, name("swing").as_ptr(), to));
        let rest = tai.get(|to| taiContextFindField(tai.0, name("rest").as_ptr(), to));
        let loss = tai.get(|to| taiContextFindField(tai.0, name("loss").as_ptr(), to));
        let gradient = tai.get(|to| taiFieldGetAdjoint(rest, to));

        let mut length = 1.0;
        for _ in 0..40 {
            tai.check(taiFieldWriteF64(rest, null(), 0, length));
            let tape = tai.get(|to| taiTapeBegin(tai.0, loss, true, to));
            tai.check(taiKernelLaunch(swing, null(), 0, null_mut()));
            tai.check(taiTapeEnd(tape));
            tai.check(taiTapeBackward(tape));
            taiTapeDestroy(tape);
            length -= 0.2 * tai.read(gradient);
        }
        println!("rest length {length:.4}, loss {:.1e}", tai.read(loss));
    }
}
