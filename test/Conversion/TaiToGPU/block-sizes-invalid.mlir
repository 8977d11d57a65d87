// Blocks of sizes that no GPU has are refused where there is one, and are
// nothing on the CPU.
//
// RUN: tai-opt %s --tai-to-nvvm --split-input-file --verify-diagnostics
// RUN: tai-opt %s --tai-to-nvvm=emulated=true --split-input-file --verify-diagnostics
// RUN: tai-opt %s --tai-to-llvm --split-input-file | FileCheck %s

// CHECK-COUNT-3: llvm.func @{{.+}}(%{{.+}}: !llvm.ptr) -> i32

tai.tree @t : !tai.root<dense<[i: 100], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @odd() {
  %one = arith.constant 1.0 : f32
  // expected-error @+1 {{'tai.parallel_for' op has block_dim 48; on a GPU it is a multiple of 32 or a power of two, and 1024 at most}}
  tai.parallel_for (%i) in @x block_dim 48 {
    tai.store %one, @x[%i] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 100], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @many() {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  %one = arith.constant 1.0 : f32
  // expected-error @+1 {{'tai.parallel_for' op has block_dim 2048; on a GPU it is}}
  tai.parallel_for (%i) = (%c0) to (%c100) block_dim 2048 {
    tai.store %one, @x[%i] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 100], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @more() {
  %one = arith.constant 1.0 : f32
  // expected-error @+1 {{'tai.parallel_for' op has block_dim 1056; on a GPU it is}}
  tai.parallel_for (%i) in @x block_dim 1056 {
    tai.store %one, @x[%i] : f32
  }
  tai.return
}
