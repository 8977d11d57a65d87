// RUN: tai-opt %s --convert-tai-to-scf --verify-diagnostics

// In deterministic mode, tai-relax-atomics leaves no addition whose order is not
// fixed. An addition that remains has lost the note of the pass on it.
tai.kernel @lost(%n: index, %x: f32) {
  %c0 = arith.constant 0 : index
  %one = llvm.mlir.constant(1 : i64) : i64
  %sum = llvm.alloca %one x f32 : (i64) -> !llvm.ptr
  tai.parallel_for (%i) = (%c0) to (%n) {
    // An iteration's own.
    %own = llvm.alloca %one x f32 : (i64) -> !llvm.ptr
    %0 = llvm.atomicrmw fadd %own, %x monotonic : !llvm.ptr, f32
    %element = llvm.getelementptr %sum[0] : (!llvm.ptr) -> !llvm.ptr, f32
    // expected-error @below {{the order of these additions is not fixed, as that of the loop is; expects tai-relax-atomics to run before, and no pass in between to drop 'tai.accumulate'}}
    %1 = llvm.atomicrmw fadd %element, %x monotonic : !llvm.ptr, f32
  } {order = #tai.loop_order<fixed>}
  tai.return
}
