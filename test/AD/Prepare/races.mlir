// RUN: tai-opt %s --tai-check-access-rules --split-input-file --verify-diagnostics

// Iterations of a parallel loop that meet for certain are reported, with both
// places. Possible meetings are left to `validation=True`.

!t = !tai.root<dense<[i: 8, j: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, n: i32}>, dense<[i: 8], {v: vector<2xf32>, v_grad: vector<2xf32>}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 2
tai.field @y_grad = @t["y_grad"] : f32, rank 2
tai.field @v_grad = @t["v_grad"] : vector<2xf32>, rank 1
tai.field @x = @t["x"] : f32, rank 2, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 2, adjoint @y_grad
tai.field @v = @t["v"] : vector<2xf32>, rank 1, adjoint @v_grad
tai.field @n = @t["n"] : i32, rank 2

// x[i, j] = sin(x[i, j - 1]): the neighbour may be old or new.
tai.kernel @sweep() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  %c16 = arith.constant 16 : index
  // expected-note @+1 {{run this loop on one thread ('serialize'), or write to another field and copy it in a later loop}}
  tai.parallel_for (%i, %j) = (%c0, %c1) to (%c8, %c16) {
    %k = arith.subi %j, %c1 : index
    // expected-error @+1 {{an element of field '@x' is read here by one iteration of a parallel loop, while another one writes it, so its value and its gradient would be wrong}}
    %0 = tai.load @x[%i, %k] : f32
    %1 = math.sin %0 : f32
    // expected-note @+1 {{written here}}
    tai.store %1, @x[%i, %j] : f32
  }
  tai.return
}

// All read the element that one of them stores.
tai.kernel @broadcast() {
  %c0 = arith.constant 0 : index
  %c3 = arith.constant 3 : index
  // expected-note @+1 {{run this loop on one thread}}
  tai.parallel_for (%i, %j) in @x {
    // expected-error @+1 {{an element of field '@x' is read here by one iteration}}
    %0 = tai.load @x[%i, %c3] : f32
    // expected-note @+1 {{written here}}
    tai.store %0, @x[%i, %j] : f32
  }
  tai.return
}

// Two stores of neighbours: one of them is lost.
tai.kernel @stores() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  %c15 = arith.constant 15 : index
  // expected-note @+1 {{run this loop on one thread ('serialize'), or accumulate with 'tai.atomic add'}}
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c8, %c15) {
    %0 = tai.load @x[%i, %j] : f32
    // expected-note @+1 {{written here}}
    tai.store %0, @y[%i, %j] : f32
    %k = arith.addi %j, %c1 : index
    // expected-error @+1 {{an element of field '@y' is written here by one iteration of a parallel loop, while another one writes it}}
    tai.store %0, @y[%i, %k] : f32
  }
  tai.return
}

// The sum of a neighbour is not complete.
tai.kernel @sum_of_neighbour() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  %c15 = arith.constant 15 : index
  // expected-note @+1 {{run this loop on one thread}}
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c8, %c15) {
    %0 = tai.load @x[%i, %j] : f32
    // expected-note @+1 {{written here}}
    tai.atomic add %0, @y[%i, %j] : f32
    %k = arith.addi %j, %c1 : index
    // expected-error @+1 {{an element of field '@y' is read here by one iteration}}
    %1 = tai.load @y[%i, %k] : f32
    tai.atomic add %1, @v[%i] component [%c0] : f32
  }
  tai.return
}

// The same behind a comparison of the index; where it leaves one iteration, the
// other one reads what it writes.
tai.kernel @behind_a_condition() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c7 = arith.constant 7 : index
  // expected-note @+1 {{run this loop on one thread}}
  tai.parallel_for (%i, %j) in @x {
    %0 = arith.cmpi sge, %j, %c1 : index
    scf.if %0 {
      %k = arith.subi %j, %c1 : index
      // expected-error @+1 {{an element of field '@x' is read here by one iteration}}
      %1 = tai.load @x[%i, %k] : f32
      // expected-note @+1 {{written here}}
      tai.store %1, @x[%i, %j] : f32
    }
  }
  // expected-note @+1 {{run this loop on one thread}}
  tai.parallel_for (%i, %j) in @x {
    // expected-error @+1 {{an element of field '@y' is read here by one iteration}}
    %1 = tai.load @y[%i, %c7] : f32
    %0 = arith.cmpi eq, %j, %c0 : index
    scf.if %0 {
      // expected-note @+1 {{written here}}
      tai.store %1, @y[%i, %c7] : f32
    }
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 8, j: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, n: i32}>, dense<[i: 8], {v: vector<2xf32>, v_grad: vector<2xf32>}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 2
tai.field @y_grad = @t["y_grad"] : f32, rank 2
tai.field @v_grad = @t["v_grad"] : vector<2xf32>, rank 1
tai.field @x = @t["x"] : f32, rank 2, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 2, adjoint @y_grad
tai.field @v = @t["v"] : vector<2xf32>, rank 1, adjoint @v_grad
tai.field @n = @t["n"] : i32, rank 2

// One's own element; a loop on one thread; other elements of the same row.
tai.kernel @legal(%t: index, %m: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i, %j] : f32
  }
  tai.parallel_for (%i) = (%c1) to (%c8) serialize {
    %k = arith.subi %i, %c1 : index
    %0 = tai.load @x[%k, %c0] : f32
    tai.store %0, @x[%i, %c0] : f32
  }
  tai.parallel_for (%i) = (%c0) to (%c8) {
    %k = arith.addi %i, %c8 : index
    %0 = tai.load @x[%c0, %k] : f32
    tai.store %0, @x[%c0, %i] : f32
  }
  // One iteration alone, or how many is not known.
  tai.parallel_for (%i) = (%c0) to (%c1) {
    %0 = tai.load @x[%c0, %c0] : f32
    tai.store %0, @y[%c0, %c0] : f32
  }
  tai.parallel_for (%i) = (%c1) to (%m) {
    %k = arith.subi %i, %c1 : index
    %0 = tai.load @x[%k, %c0] : f32
    tai.store %0, @x[%i, %c0] : f32
  }
  tai.return
}

// Odd elements are read, even ones written; two time steps; a component each;
// under a condition; values of a field.
tai.kernel @unproven(%s: index, %t: index, %c: i1) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c7 = arith.constant 7 : index
  tai.parallel_for (%i) = (%c0) to (%c7) {
    %even = arith.muli %i, %c2 : index
    %odd = arith.addi %even, %c1 : index
    %0 = tai.load @x[%c0, %odd] : f32
    tai.store %0, @x[%c0, %even] : f32
    %1 = tai.load @y[%s, %i] : f32
    %next = arith.addi %i, %c1 : index
    tai.store %1, @y[%t, %next] : f32
    %2 = tai.load @v[%i] component [%c0] : f32
    tai.store %2, @v[%next] component [%c1] : f32
  }
  // Behind conditions that keep the iterations apart.
  tai.parallel_for (%i) = (%c0) to (%c7) {
    %next = arith.addi %i, %c1 : index
    %low = arith.cmpi slt, %i, %c2 : index
    scf.if %low {
      %0 = tai.load @x[%c1, %i] : f32
      tai.store %0, @y[%c1, %i] : f32
    }
    %high = arith.cmpi sgt, %i, %c2 : index
    scf.if %high {
      %0 = tai.load @y[%c1, %next] : f32
      tai.store %0, @x[%c1, %next] : f32
    }
  }
  tai.parallel_for (%i) = (%c0) to (%c7) {
    %next = arith.addi %i, %c1 : index
    %0 = tai.load @y[%c0, %next] : f32
    scf.if %c {
      tai.store %0, @y[%c0, %i] : f32
    }
    %1 = tai.load @n[%c0, %i] : i32
    %2 = arith.index_cast %1 : i32 to index
    tai.store %0, @x[%c0, %2] : f32
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 16, j: 16], {x: f32, x_grad: f32}>, dense<[i: 16], {z: f32, z_grad: f32, y: f32, y_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 2
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @z_grad = @t["z_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 2, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f32, rank 1, adjoint @z_grad

// x[i, 5] and x[5, i] are the same element in iteration 5 alone.
tai.kernel @row_and_column() {
  %c5 = arith.constant 5 : index
  tai.parallel_for (%i) in @y {
    %0 = tai.load @x[%c5, %i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i, %c5] : f32
  }
  tai.return
}

// x[i, 5] and x[4, i] are in iterations 4 and 5.
tai.kernel @another_row() {
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  // expected-note @+1 {{run this loop on one thread}}
  tai.parallel_for (%i) in @y {
    // expected-error @+1 {{an element of field '@x' is read here by one iteration}}
    %0 = tai.load @x[%c4, %i] : f32
    %1 = math.sin %0 : f32
    // expected-note @+1 {{written here}}
    tai.store %1, @x[%i, %c5] : f32
  }
  tai.return
}

// All read an element of the first index, which one of them stores.
tai.kernel @one_of_the_first_index(%s: f32) {
  %c3 = arith.constant 3 : index
  // expected-note @+1 {{run this loop on one thread}}
  tai.parallel_for (%i) in @y {
    // expected-note @+1 {{written here}}
    tai.store %s, @y[%i] : f32
    // expected-error @+1 {{an element of field '@y' is read here by one iteration}}
    %0 = tai.load @y[%c3] : f32
    tai.store %0, @z[%i] : f32
  }
  tai.return
}

// One iteration stores the element that another one reads.
tai.kernel @store_of_one_iteration(%s: f32) {
  %c3 = arith.constant 3 : index
  %c5 = arith.constant 5 : index
  // expected-note @+1 {{run this loop on one thread}}
  tai.parallel_for (%i) in @y {
    // expected-error @+1 {{an element of field '@y' is read here by one iteration}}
    %0 = tai.load @y[%i] : f32
    tai.store %0, @z[%i] : f32
    %1 = arith.cmpi eq, %i, %c3 : index
    scf.if %1 {
      // expected-note @+1 {{written here}}
      tai.store %s, @y[%c5] : f32
    }
  }
  tai.return
}

// An element that no iteration stores behind these conditions: by a bound from
// above or below, an equality, or the second one of two conditions.
tai.kernel @not_behind_conditions(%c: i1) {
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c15 = arith.constant 15 : index
  %false = arith.constant false
  %true = arith.constant true
  tai.parallel_for (%i) in @y {
    %0 = tai.load @y[%c7] : f32
    %1 = arith.cmpi slt, %i, %c7 : index
    scf.if %1 {
      tai.store %0, @y[%i] : f32
    }
    %2 = arith.cmpi sgt, %i, %c7 : index
    scf.if %2 {
      tai.store %0, @y[%i] : f32
    }
    %3 = arith.cmpi eq, %c8, %i : index
    scf.if %3 {
      tai.store %0, @y[%i] : f32
    }
    %4 = arith.cmpi sge, %i, %c8 : index
    %5 = scf.if %2 -> i1 {
      scf.yield %4 : i1
    } else {
      scf.yield %false : i1
    }
    scf.if %5 {
      tai.store %0, @y[%i] : f32
    }
  }
  tai.parallel_for (%i) in @y {
    %0 = tai.load @z[%c7] : f32
    %1 = arith.cmpi slt, %i, %c15 : index
    %2 = arith.cmpi sge, %i, %c8 : index
    %3 = scf.if %1 -> i1 {
      scf.yield %2 : i1
    } else {
      scf.yield %false : i1
    }
    scf.if %3 {
      tai.store %0, @z[%i] : f32
    }
    // Neither of "i >= 15 or i <= 7".
    %4 = arith.cmpi sge, %i, %c15 : index
    %5 = arith.cmpi sle, %i, %c7 : index
    %6 = scf.if %4 -> i1 {
      scf.yield %true : i1
    } else {
      scf.yield %5 : i1
    }
    scf.if %6 {
    } else {
      tai.store %0, @z[%i] : f32
    }
  }
  tai.return
}
