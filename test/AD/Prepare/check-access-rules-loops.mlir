// RUN: tai-opt %s --tai-check-access-rules --verify-diagnostics

// Races on arrays, and loops of which nobody knows how often they run.

!t = !tai.root<dense<[i: 8], dense<[i: 8], {x: f32, x_grad: f32}>>, bitmasked<[i: 64], {h: f32, h_grad: f32}>, {s: f32, s_grad: f32}>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @h_grad = @t["h_grad"] : f32, rank 1
tai.field @s_grad = @t["s_grad"] : f32, rank 0
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @h = @t["h"] : f32, rank 1, adjoint @h_grad
tai.field @s = @t["s"] : f32, rank 0, adjoint @s_grad

// Each store is reported once, however many loops it does not move with.
func.func @array(%x: memref<8xf32>, %y: memref<8xf32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  // expected-note @+1 {{the indices do not depend on this loop}}
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c8, %c8) {
    %0 = memref.load %x[%i] : memref<8xf32>
    // expected-error @+2 {{an element of array is overwritten in every iteration of a parallel loop, so its value and its gradient would be wrong}}
    // expected-note @+1 {{accumulate with 'tai.atomic add', or store to an element for each iteration}}
    memref.store %0, %y[%c1] : memref<8xf32>
  }
  return
}

// Active cells of a sparse field may be one, blocks of a level too; so may the
// iterations of bounds that are known when it runs.
tai.kernel @one_perhaps(%n: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @h {
    %0 = tai.load @h[%i] : f32
    tai.store %0, @s[] : f32
  }
  tai.parallel_for (%i) in @x level 1 {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @s[] : f32
  }
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @s[] : f32
  }
  tai.return
}

// A serial loop in between leaves the parallel one around it to be asked, but not
// where it decides on the element by what it carries or computes.
tai.kernel @through_serial_loops(%n: index) {
  %c0 = arith.constant 0 : index
  %c2 = arith.constant 2 : index
  %c8 = arith.constant 8 : index
  // expected-note @+1 {{the indices do not depend on this loop}}
  tai.parallel_for (%i) = (%c0) to (%c8) {
    %0 = tai.load @x[%i] : f32
    scf.for %k = %c0 to %c8 step %c2 {
      // expected-error @+2 {{an element of field '@x' is overwritten in every iteration of a parallel loop}}
      // expected-note @+1 {{accumulate with 'tai.atomic add'}}
      tai.store %0, @x[%k] : f32
    }
  }
  tai.parallel_for (%i) = (%c0) to (%c8) {
    %0 = tai.load @h[%i] : f32
    %r = scf.for %k = %c0 to %c8 step %c2 iter_args(%at = %i) -> index {
      tai.store %0, @h[%at] : f32
      %next = arith.addi %at, %c2 : index
      scf.yield %next : index
    }
  }
  tai.return
}
