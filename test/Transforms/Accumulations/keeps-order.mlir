// RUN: tai-opt %s --tai-relax-atomics --tai-lower-layout | FileCheck %s

// LLVM looks for no dependences in loops that are annotated as parallel, not
// even for those within an iteration, and combines accesses at a stride.

!plane = !tai.root<dense<[i: 8, j: 64], {z: f64}>>
tai.tree @planes : !plane
tai.field @z = @planes["z"] : f64, rank 2
!scene = !tai.root<dense<[i: 64], {m: vector<2xf64>}>, dense<[i: 64], {x: f64}>, dense<[i: 128], {y: f64}>, dense<[i: 64], {a: f64, b: f64}>>
tai.tree @scene : !scene
tai.field @m = @scene["m"] : vector<2xf64>, rank 1
tai.field @x = @scene["x"] : f64, rank 1
tai.field @y = @scene["y"] : f64, rank 1
tai.field @a = @scene["a"] : f64, rank 1
tai.field @b = @scene["b"] : f64, rank 1

// A component is stored and then read again.
// CHECK-LABEL: tai.kernel @stored_then_read(
//   CHECK-NOT:   access_groups
//       CHECK:   tai.return
tai.kernel @stored_then_read(%v: f64) {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  %zero = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    tai.store %v, @m[%i] component [%zero] : f64
    %old = tai.load @m[%i] component [%zero] : f64
    tai.store %old, @x[%i] : f64
  }
  tai.return
}

// Read first: nothing is moved past a store.
// CHECK-LABEL: tai.kernel @read_then_stored(
//       CHECK:   access_groups
//       CHECK:   tai.return
tai.kernel @read_then_stored(%v: f64) {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  %zero = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %old = tai.load @m[%i] component [%zero] : f64
    %new = arith.addf %old, %v : f64
    tai.store %new, @m[%i] component [%zero] : f64
  }
  tai.return
}

// Another component is another element.
// CHECK-LABEL: tai.kernel @other_component(
//       CHECK:   access_groups
//       CHECK:   tai.return
tai.kernel @other_component(%v: f64) {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  %zero = arith.constant 0 : index
  %one = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    tai.store %v, @m[%i] component [%zero] : f64
    %old = tai.load @m[%i] component [%one] : f64
    tai.store %old, @x[%i] : f64
  }
  tai.return
}

// Neighbouring elements of a scalar field make no groups.
// CHECK-LABEL: tai.kernel @side_by_side(
//       CHECK:   access_groups
//       CHECK:   tai.return
tai.kernel @side_by_side(%v: f64) {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    tai.store %v, @x[%i] : f64
    %old = tai.load @x[%i] : f64
    %new = arith.addf %old, %v : f64
    tai.store %new, @x[%i] : f64
  }
  tai.return
}

// The innermost loop is over the last index, along which elements lie side by side.
// CHECK-LABEL: tai.kernel @rows(
//       CHECK:   access_groups
//       CHECK:   tai.return
tai.kernel @rows(%v: f64) {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c8, %c64) {
    tai.store %v, @z[%i, %j] : f64
    %old = tai.load @z[%i, %j] : f64
    tai.store %old, @z[%i, %j] : f64
  }
  tai.return
}

// Here it goes from row to row.
// CHECK-LABEL: tai.kernel @columns(
//   CHECK-NOT:   access_groups
//       CHECK:   tai.return
tai.kernel @columns(%v: f64) {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%j, %i) = (%c0, %c0) to (%c64, %c8) {
    tai.store %v, @z[%i, %j] : f64
    %old = tai.load @z[%i, %j] : f64
    tai.store %old, @z[%i, %j] : f64
  }
  tai.return
}

// Fields that share their cells are strided whatever the index.
// CHECK-LABEL: tai.kernel @shared_cells(
//   CHECK-NOT:   access_groups
//       CHECK:   tai.return
tai.kernel @shared_cells(%v: f64) {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    tai.store %v, @a[%i] : f64
    %old = tai.load @a[%i] : f64
    tai.store %old, @b[%i] : f64
  }
  tai.return
}

// So are every second elements.
// CHECK-LABEL: tai.kernel @every_second(
//   CHECK-NOT:   access_groups
//       CHECK:   tai.return
tai.kernel @every_second(%v: f64) {
  %c0 = arith.constant 0 : index
  %c2 = arith.constant 2 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %j = arith.muli %i, %c2 : index
    tai.store %v, @y[%j] : f64
    %old = tai.load @y[%j] : f64
    tai.store %old, @x[%i] : f64
  }
  tai.return
}

// An iteration makes one of the two additions: it is in the interior or at a
// border.
// CHECK-LABEL: tai.kernel @exclusive_arms(
//       CHECK:   access_groups
//       CHECK:   tai.return
tai.kernel @exclusive_arms(%v: f64, %c: i1) {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  %zero = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    scf.if %c {
      tai.store %v, @m[%i] component [%zero] : f64
    } else {
      %old = tai.load @m[%i] component [%zero] : f64
      tai.store %old, @x[%i] : f64
    }
  }
  tai.return
}

// Rounds of a serial loop may come to both arms, one after the other.
// CHECK-LABEL: tai.kernel @arms_in_rounds(
//   CHECK-NOT:   access_groups
//       CHECK:   tai.return
tai.kernel @arms_in_rounds(%v: f64) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c64 = arith.constant 64 : index
  %zero = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    scf.for %k = %c0 to %c2 step %c1 {
      %c = arith.cmpi eq, %k, %c0 : index
      scf.if %c {
        tai.store %v, @m[%i] component [%zero] : f64
      } else {
        %old = tai.load @m[%i] component [%zero] : f64
        tai.store %old, @x[%i] : f64
      }
    }
  }
  tai.return
}
