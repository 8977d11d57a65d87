// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-to-llvm
// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-to-nvvm

// Parallel loops of other dialects are refused at their place.
tai.kernel @parallel(%m: memref<?xf32>, %n: index, %v: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  // expected-error @+2 {{'scf.parallel' op is not lowered in code of tai}}
  // expected-note @+1 {{write 'tai.parallel_for' at the top level of a kernel}}
  scf.parallel (%i) = (%c0) to (%n) step (%c1) {
    memref.store %v, %m[%i] : memref<?xf32>
  }
  tai.return
}

// -----

tai.kernel @forall(%m: memref<?xf32>, %n: index, %v: f32, %c: i1) {
  scf.if %c {
    // expected-error @+2 {{'scf.forall' op is not lowered in code of tai}}
    // expected-note @+1 {{or 'scf.for' for those that run in order}}
    scf.forall (%i) in (%n) {
      memref.store %v, %m[%i] : memref<?xf32>
    }
  }
  tai.return
}
