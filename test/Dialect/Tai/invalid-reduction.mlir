// RUN: tai-opt %s --allow-unregistered-dialect --split-input-file --verify-diagnostics

!t = !tai.root<dense<[i: 8], {x: f32, n: i32}>>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @two(%i: index, %v: f32) {
  // (atomic_c6)
  // expected-error @below {{'tai.atomic' op is exclusive, and has a reduction}}
  tai.atomic add %v, @x[%i] exclusive reduction <register own any> : f32
  tai.return
}

// -----

!t = !tai.root<dense<[i: 8], {x: f32, n: i32}>>
tai.tree @t : !t
tai.field @n = @t["n"] : i32, rank 1
tai.kernel @integers(%i: index, %v: i32) {
  // expected-error @below {{which only sums of floats have}}
  tai.atomic add %v, @n[%i] reduction <register wide any> : i32
  tai.return
}

// -----

!t = !tai.root<dense<[i: 8], {x: f32, n: i32}>>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @products(%i: index, %v: f32) {
  // expected-error @below {{which only sums of floats have}}
  tai.atomic mul %v, @x[%i] reduction <fixed own any buffer 0> : f32
  tai.return
}

// -----

// expected-error @below {{expects the number of a buffer with the forms 'buffer' and 'fixed', and with no other}}
"test.op"() {r = #tai.reduction<buffer own any>} : () -> ()

// -----

// expected-error @below {{expects the number of a buffer with the forms 'buffer' and 'fixed', and with no other}}
"test.op"() {r = #tai.reduction<register own any buffer 1>} : () -> ()

// -----

// expected-error @below {{expects the order 'any' of what is in a buffer}}
"test.op"() {r = #tai.reduction<fixed own common buffer 1>} : () -> ()

// -----

// expected-error @below {{expects a block, of at least one iteration, with sums in a register alone}}
"test.op"() {r = #tai.reduction<register own lanes block 64>} : () -> ()

// -----

// expected-error @below {{expects a block, of at least one iteration, with sums in a register alone}}
"test.op"() {r = #tai.reduction<buffer own any block 64 buffer 0>} : () -> ()

// -----

// expected-error @below {{expects own digits in fixed point and in the common order}}
"test.op"() {r = #tai.reduction<register pair common>} : () -> ()

// -----

tai.kernel @local(%m: memref<4xf32>, %i: index, %v: f32) {
  // expected-error @below {{expects 'tai.accumulate' to be a #tai.reduction in a register}}
  %0 = memref.atomic_rmw addf %v, %m[%i] {tai.accumulate = "register"} : (f32, memref<4xf32>) -> f32
  tai.return
}
