// RUN: tai-opt %s --tai-check-access-rules --split-input-file --verify-diagnostics

// A certain breach of a rule is reported; the rest of the file is legal, or
// cannot be proven, and stays silent.

!t = !tai.root<dense<[i: 8, j: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 2
tai.field @y_grad = @t["y_grad"] : f32, rank 2
tai.field @x = @t["x"] : f32, rank 2, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 2, adjoint @y_grad

// All iterations along i store to one element.
tai.kernel @overwritten_in_loop() {
  %c0 = arith.constant 0 : index
  // expected-note @+1 {{the indices do not depend on this loop}}
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : f32
    // expected-error @+2 {{an element of field '@y' is overwritten in every iteration of a parallel loop, so its value and its gradient would be wrong}}
    // expected-note @+1 {{accumulate with 'tai.atomic add', or store to an element for each iteration}}
    tai.store %0, @y[%c0, %j] : f32
  }
  tai.return
}

// The sum is not complete while the loop that sums runs.
tai.kernel @early_read() {
  %c0 = arith.constant 0 : index
  // expected-note @+1 {{run this loop on one thread ('serialize')}}
  tai.parallel_for (%i, %j) in @x {
    // expected-error @+1 {{an element of field '@x' is read here by one iteration of a parallel loop, while another one writes it}}
    %0 = tai.load @x[%i, %j] : f32
    // expected-note @+1 {{other iterations of the loop still accumulate here}}
    tai.atomic add %0, @y[%c0, %c0] : f32
    // expected-error @+2 {{an element of field '@y' is read before its accumulation is done, so its value and its gradient would be wrong}}
    // expected-note @+1 {{read it in a later loop}}
    %1 = tai.load @y[%c0, %c0] : f32
    // expected-note @+1 {{written here}}
    tai.atomic add %1, @x[%c0, %j] : f32
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 8, j: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, n: i32, plain: f32, v: vector<2xf32>, v_grad: vector<2xf32>}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 2
tai.field @y_grad = @t["y_grad"] : f32, rank 2
tai.field @v_grad = @t["v_grad"] : vector<2xf32>, rank 2
tai.field @x = @t["x"] : f32, rank 2, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 2, adjoint @y_grad
tai.field @v = @t["v"] : vector<2xf32>, rank 2, adjoint @v_grad
tai.field @n = @t["n"] : i32, rank 2
tai.field @plain = @t["plain"] : f32, rank 2

// Within an iteration, and from loop to loop, the order of accesses is known.
tai.kernel @in_place(%c: i1) {
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i, %j] : f32
    tai.atomic add %1, @x[%i, %j] : f32
    scf.if %c {
      tai.store %0, @x[%i, %j] : f32
    }
  }
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @y[%i, %j] : f32
    tai.store %0, @x[%i, %j] : f32
  }
  tai.return
}

// So is that of the iterations of a serial loop.
tai.kernel @overwritten_in_serial_loop() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%j) = (%c0) to (%c8) {
    scf.for %i = %c0 to %c8 step %c1 {
      %0 = tai.load @x[%i, %j] : f32
      tai.store %0, @y[%c0, %j] : f32
    }
  }
  tai.parallel_for (%i) = (%c0) to (%c8) serialize {
    %0 = tai.load @x[%i, %c0] : f32
    tai.store %0, @y[%c0, %c0] : f32
  }
  tai.return
}

// One time step reads the one before.
tai.kernel @step(%t: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c16 = arith.constant 16 : index
  %before = arith.subi %t, %c1 : index
  tai.parallel_for (%j) = (%c0) to (%c16) {
    %0 = tai.load @x[%before, %j] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%t, %j] : f32
    %2 = tai.load @x[%t, %j] : f32
    tai.store %2, @y[%t, %j] : f32
  }
  tai.return
}

// Accumulate as often as you like, and read in a later loop.
tai.kernel @accumulate_then_read() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : f32
    tai.atomic add %0, @y[%c0, %c0] : f32
    tai.atomic sub %0, @y[%c0, %c0] : f32
  }
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @y[%c0, %c0] : f32
    tai.atomic add %0, @plain[%i, %j] : f32
  }
  tai.return
}

// An element that one iteration accumulates is complete for that iteration.
tai.kernel @own_element() {
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : f32
    tai.store %0, @y[%i, %j] : f32
    tai.atomic add %0, @y[%i, %j] : f32
    %1 = tai.load @y[%i, %j] : f32
    tai.atomic add %1, @v[%i, %j] component [%j] : f32
  }
  tai.return
}

// Clearing loses no derivative; a field without an adjoint has none.
tai.kernel @clear_and_count() {
  %zero = arith.constant 0.0 : f32
  %one = arith.constant 1 : i32
  tai.parallel_for (%i, %j) in @x {
    tai.store %zero, @y[%i, %j] : f32
    %0 = tai.load @x[%i, %j] : f32
    tai.store %0, @y[%i, %j] : f32
    %1 = tai.load @plain[%i, %j] : f32
    %2 = arith.mulf %1, %1 : f32
    tai.store %2, @plain[%i, %j] : f32
    %3 = tai.load @n[%i, %j] : i32
    %4 = arith.addi %3, %one : i32
    tai.store %4, @n[%i, %j] : i32
  }
  tai.return
}

// Each arm writes once.
tai.kernel @either(%c: i1, %d: i1) {
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : f32
    scf.if %c {
      tai.store %0, @y[%i, %j] : f32
    } else {
      %1 = math.sin %0 : f32
      tai.store %1, @y[%i, %j] : f32
    }
  }
  tai.return
}

// Two conditions may exclude each other: even cells read, odd ones are written.
tai.kernel @conditions(%c: i1, %d: i1) {
  tai.parallel_for (%i, %j) in @x {
    scf.if %c {
      %0 = tai.load @x[%i, %j] : f32
      tai.atomic add %0, @y[%i, %j] : f32
    }
    scf.if %d {
      %1 = tai.load @y[%j, %i] : f32
      tai.store %1, @x[%i, %j] : f32
    }
  }
  tai.return
}

// Components of one element are elements of their own.
tai.kernel @components() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @v[%i, %j] component [%c0] : f32
    tai.store %0, @v[%i, %j] component [%c1] : f32
  }
  tai.return
}

// Whether two symbols are equal, or an index read from a field repeats, is not
// known here.
tai.kernel @unknown(%s: index, %t: index) {
  %c0 = arith.constant 0 : index
  %c16 = arith.constant 16 : index
  tai.parallel_for (%j) = (%c0) to (%c16) {
    %0 = tai.load @x[%s, %j] : f32
    tai.store %0, @x[%t, %j] : f32
    %1 = tai.load @n[%s, %j] : i32
    %2 = arith.index_cast %1 : i32 to index
    tai.store %0, @y[%s, %2] : f32
  }
  tai.return
}

// An index that depends on the loop, or a branch around the store: no proof.
tai.kernel @moving(%c: i1) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%j) = (%c0) to (%c8) {
    scf.for %i = %c0 to %c8 step %c1 {
      %0 = tai.load @x[%i, %j] : f32
      tai.store %0, @y[%i, %j] : f32
      scf.if %c {
        tai.store %0, @v[%c0, %j] component [%c0] : f32
      }
    }
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 8, j: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 2
tai.field @y_grad = @t["y_grad"] : f32, rank 2
tai.field @x = @t["x"] : f32, rank 2, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 2, adjoint @y_grad

// Two serial loops over the same range reach the same elements.
tai.kernel @serial_loops(%n: index, %m: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%j) = (%c0) to (%c8) {
    scf.for %a = %c0 to %n step %c1 {
      %0 = tai.load @x[%a, %j] : f32
      // expected-note @+1 {{other iterations of the loop still accumulate here}}
      tai.atomic add %0, @y[%a, %c0] : f32
    }
    scf.for %b = %c0 to %n step %c1 {
      // expected-error @+2 {{an element of field '@y' is read before its accumulation is done}}
      // expected-note @+1 {{read it in a later loop}}
      %1 = tai.load @y[%b, %c0] : f32
      tai.store %1, @x[%b, %j] : f32
    }
  }
  tai.return
}

// Loops over other ranges may not reach the element at all: other ends, other
// beginnings, other steps.
tai.kernel @other_range_a(%n: index, %m: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%j) = (%c0) to (%c8) {
    scf.for %a = %c0 to %n step %c1 {
      %0 = tai.load @x[%a, %j] : f32
      tai.atomic add %0, @y[%a, %c0] : f32
    }
    scf.for %b = %c0 to %m step %c1 {
      %1 = tai.load @y[%b, %c0] : f32
      tai.store %1, @x[%b, %j] : f32
    }
  }
  tai.return
}
tai.kernel @other_range_b(%n: index, %m: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%j) = (%c0) to (%c8) {
    scf.for %a = %c0 to %n step %c1 {
      %0 = tai.load @x[%a, %j] : f32
      tai.atomic add %0, @y[%a, %c0] : f32
    }
    scf.for %b = %c1 to %n step %c1 {
      %1 = tai.load @y[%b, %c0] : f32
      tai.store %1, @x[%b, %j] : f32
    }
  }
  tai.return
}
tai.kernel @other_range_c(%n: index, %m: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%j) = (%c0) to (%c8) {
    scf.for %a = %c0 to %n step %c1 {
      %0 = tai.load @x[%a, %j] : f32
      tai.atomic add %0, @y[%a, %c0] : f32
    }
    scf.for %b = %c0 to %n step %c2 {
      %1 = tai.load @y[%b, %c0] : f32
      tai.store %1, @x[%b, %j] : f32
    }
  }
  tai.return
}
