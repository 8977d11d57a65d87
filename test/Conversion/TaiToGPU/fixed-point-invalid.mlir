// RUN: tai-opt %s --convert-tai-to-gpu --split-input-file --verify-diagnostics

// A buffer that a CPU could have: a GPU has too many threads for it.
tai.tree @t : !tai.root<dense<[i: 100], {v: f32}>>
tai.field @v = @t["v"] : f32, rank 1
tai.kernel @own_digits(%x: f32, %j: index) {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    // expected-error @below {{has a buffer, which on a GPU only sums of floats in wide digits have}}
    tai.atomic add %x, @v[%j] reduction <buffer own any buffer 0> : f32
  }
  tai.return
}

// -----

// Somebody looks at the old value.
tai.tree @t : !tai.root<dense<[i: 100], {v: f32}>>
tai.field @v = @t["v"] : f32, rank 1
tai.kernel @old(%x: f32, %j: index) {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    // expected-error @below {{has a buffer, which on a GPU only sums of floats in wide digits have}}
    %old = tai.atomic add %x, @v[%j] reduction <fixed own any buffer 0> : f32
    tai.store %old, @v[%i] : f32
  }
  tai.return
}
