// RUN: tai-opt %s --convert-tai-to-gpu=deterministic=true --split-input-file --verify-diagnostics

// Products have no fixed point.
tai.tree @t : !tai.root<dense<[i: 100], {v: f32}>>
tai.field @v = @t["v"] : f32, rank 1
tai.kernel @product(%x: f32, %j: index) {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    // expected-error @below {{has a private buffer, which on a GPU only additions of floats have}}
    tai.atomic mul %x, @v[%j] strategy private buffer 0 : f32
  }
  tai.return
}

// -----

// It has no number.
tai.tree @t : !tai.root<dense<[i: 100], {v: f32}>>
tai.field @v = @t["v"] : f32, rank 1
tai.kernel @no_number(%x: f32, %j: index) {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    // expected-error @below {{has a private buffer, which on a GPU only additions of floats have}}
    tai.atomic add %x, @v[%j] strategy private : f32
  }
  tai.return
}
