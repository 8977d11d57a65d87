// RUN: tai-opt %s --tai-to-nvvm --split-input-file -verify-diagnostics

// Arrays that parts of a kernel share are memory of the device.

tai.kernel @no_size(%n: index, %x: f32) {
  %c0 = arith.constant 0 : index
  %one = llvm.mlir.constant(1 : i64) : i64
  // expected-error @+1 {{allocates 'memref<f32>', whose size is unknown; parts of a kernel on a GPU cannot share it}}
  %sum = llvm.alloca %one x memref<f32> : (i64) -> !llvm.ptr
  tai.parallel_for (%i) = (%c0) to (%n) {
    %element = llvm.getelementptr %sum[0] : (!llvm.ptr) -> !llvm.ptr, f32
    %0 = llvm.atomicrmw fadd %element, %x monotonic : !llvm.ptr, f32
  }
  tai.return
}

// -----

tai.kernel @no_size_inside(%n: index, %x: f32) {
  %c0 = arith.constant 0 : index
  %one = llvm.mlir.constant(1 : i64) : i64
  // expected-error @+1 {{allocates '!llvm.struct<(f32, vector<[4]xf32>)>', whose size is unknown}}
  %sum = llvm.alloca %one x !llvm.struct<(f32, vector<[4]xf32>)> : (i64) -> !llvm.ptr
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = llvm.atomicrmw fadd %sum, %x monotonic : !llvm.ptr, f32
  }
  tai.return
}

// -----

// The device would have memory for one element.
tai.kernel @computed(%n: index, %count: i64, %x: f32) {
  %c0 = arith.constant 0 : index
  // expected-error @+1 {{allocates a number of elements that is computed, negative or too large}}
  %sum = llvm.alloca %count x f32 : (i64) -> !llvm.ptr
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = llvm.atomicrmw fadd %sum, %x monotonic : !llvm.ptr, f32
  }
  tai.return
}

// -----

tai.kernel @too_large(%n: index, %x: f32) {
  %c0 = arith.constant 0 : index
  %count = llvm.mlir.constant(9223372036854775807 : i64) : i64
  // expected-error @+1 {{allocates a number of elements that is computed, negative or too large}}
  %sum = llvm.alloca %count x f32 : (i64) -> !llvm.ptr
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = llvm.atomicrmw fadd %sum, %x monotonic : !llvm.ptr, f32
  }
  tai.return
}
