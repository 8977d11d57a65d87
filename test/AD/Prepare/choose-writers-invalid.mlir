// RUN: tai-opt %s --tai-choose-writers --verify-diagnostics

!t = !tai.root<bitmasked<[i: 64], {x: f32, x_grad: f32}>,
               dense<[i: 64], {y: f32, y_grad: f32}>,
               dense<[i: 64], {p: i32}>,
               dense<[i: 8], dense<[i: 8], {deep: f32, deep_grad: f32}>>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @p = @t["p"] : i32, rank 1
tai.field @deep_grad = @t["deep_grad"] : f32, rank 1
tai.field @deep = @t["deep"] : f32, rank 1, adjoint @deep_grad

tai.kernel @changes() {
  %c2 = arith.constant 2 : index
  // expected-note @below {{the loop visits the cells of a sparse field}}
  tai.parallel_for (%i) in @x {
    %half = arith.divsi %i, %c2 : index
    %n = arith.index_cast %i : index to i32
    tai.store %n, @p[%half] : i32
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    // expected-error @below {{iterations of a parallel loop may write the same element here, and which of them is the last cannot be decided before the loop}}
    // expected-note @below {{compute the index, and the condition, in an earlier loop and store them to fields}}
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

tai.kernel @foreign(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  // expected-note @below {{the iterations of 'scf.parallel' have no order}}
  scf.parallel (%i) = (%c0) to (%n) step (%c1) {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    // expected-error @below {{iterations of a parallel loop may store to the same element here, and the gradient belongs to the one whose value remains}}
    // expected-note @below {{store to an element for each iteration, or write the loop as 'tai.parallel_for' or as 'scf.for'}}
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

// The blocks of a level are cells, too.
tai.kernel @level() {
  // expected-note @below {{the loop visits the cells of a sparse field}}
  tai.parallel_for (%i) in @deep level 1 {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    // expected-error @below {{iterations of a parallel loop may write the same element here, and which of them is the last cannot be decided before the loop}}
    // expected-note @below {{compute the index, and the condition, in an earlier loop and store them to fields}}
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

// A run-time step, or bounds of one that are, may make several iterations; a
// constant, and an array of the iteration, leave no derivative to another.
tai.kernel @steps(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %half = arith.constant 0.5 : f32
  // expected-note @below {{the iterations of 'scf.parallel' have no order}}
  scf.parallel (%i) = (%c0) to (%c4) step (%n) {
    %0 = tai.load @x[%i] : f32
    tai.store %half, @y[%c1] : f32
    %m = memref.alloca() : memref<1xf32>
    memref.store %half, %m[%c0] : memref<1xf32>
    // expected-error @below {{iterations of a parallel loop may store to the same element here}}
    // expected-note @below {{store to an element for each iteration}}
    tai.store %0, @y[%c0] : f32
  }
  // expected-note @below {{the iterations of 'scf.parallel' have no order}}
  scf.parallel (%i) = (%n) to (%c4) step (%c1) {
    %0 = tai.load @x[%i] : f32
    // expected-error @below {{iterations of a parallel loop may store to the same element here}}
    // expected-note @below {{store to an element for each iteration}}
    tai.store %0, @y[%c0] : f32
  }
  // expected-note @below {{the iterations of 'scf.parallel' have no order}}
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    %0 = tai.load @x[%i] : f32
    %next = arith.addi %i, %c1 : index
    // expected-error @below {{iterations of a parallel loop may store to the same element here}}
    // expected-note @below {{store to an element for each iteration}}
    tai.store %0, @y[%next] : f32
    tai.store %0, @y[%i] : f32
  }
  tai.return
}

// One iteration has no other to meet; nobody asks for the derivative of integers.
tai.kernel @alone() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.parallel (%i) = (%c0) to (%c1) step (%c1) {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%c0] : f32
  }
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    %k = tai.load @p[%i] : i32
    tai.store %k, @p[%c0] : i32
  }
  tai.return
}
