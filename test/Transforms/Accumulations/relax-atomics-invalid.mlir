// A compensated sum that would be rounded to its type at each addition is an error at the
// addition.
// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-relax-atomics

!t = !tai.root<dense<[i: 64], {x: f32}>, dense<[j: 8], {s: f32}>>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @s = @t["s"] : f32, rank 1
tai.kernel @old_value(%n: index) attributes {modes = {sums = "compensated"}} {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %0 = tai.load @x[%i] : f32
    // expected-error @+1 {{sums="compensated" cannot be had for this sum: the value before the addition is used; give the kernel sums="default"}}
    %1 = tai.atomic add %0, @s[%c0] : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 64], {x: f32}>, dense<[j: 8], {s: f32}>>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @s = @t["s"] : f32, rank 1
tai.kernel @read_beside(%n: index) attributes {modes = {sums = "compensated"}} {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @s[%c0] : f32
    %2 = arith.addf %0, %1 : f32
    // expected-error @+1 {{its field is sparse or large, or takes other updates or reads in the same loop}}
    tai.atomic add %2, @s[%c0] : f32
  }
  tai.return
}

// -----

tai.kernel @array(%x: memref<?xf32>, %at: index) attributes {modes = {sums = "compensated"}} {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %0 = memref.load %x[%i] : memref<?xf32>
    // expected-error @+1 {{it is in an array of the caller; give the kernel sums="default", or add up in a field}}
    memref.atomic_rmw addf %0, %x[%at] : (f32, memref<?xf32>) -> f32
  }
  tai.return
}
