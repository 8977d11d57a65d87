// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s

// A zero adjoint contributes zero, whatever the partial is. The guard is there
// where the partial may be infinite or NaN, and nowhere else.

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, z: f32, z_grad: f32, v: vector<2xf32>, v_grad: vector<2xf32>}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @z_grad = @t["z_grad"] : f32, rank 1
tai.field @v_grad = @t["v_grad"] : vector<2xf32>, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f32, rank 1, adjoint @z_grad
tai.field @v = @t["v"] : vector<2xf32>, rank 1, adjoint @v_grad

// CHECK-LABEL: tai.kernel @root_grad(
//   CHECK-DAG:   %[[ZERO:.+]] = arith.constant 0.000000e+00 : f32
//       CHECK:   %[[R:.+]] = math.sqrt
//       CHECK:   %[[G:.+]] = tai.load @y_grad
//       CHECK:   %[[D:.+]] = arith.divf %[[G]], %{{.+}}
//       CHECK:   %[[IS_ZERO:.+]] = arith.cmpf oeq, %[[G]], %[[ZERO]]
//       CHECK:   %[[GUARDED:.+]] = arith.select %[[IS_ZERO]], %[[ZERO]], %[[D]]
//       CHECK:   tai.atomic add %[[GUARDED]], @x_grad
tai.kernel @root() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sqrt %0 : f32
    tai.store %1, @y[%i] : f32
  }
  tai.return
}

// The root of a square plus a positive number cannot be zero.
// CHECK-LABEL: tai.kernel @safe_root_grad(
//   CHECK-NOT:   arith.select
//       CHECK:   tai.return
tai.kernel @safe_root() {
  %eps = arith.constant 1.0e-6 : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    %2 = arith.addf %1, %eps : f32
    %3 = math.sqrt %2 : f32
    tai.store %3, @y[%i] : f32
  }
  tai.return
}

// Nor can a constant, or a norm plus a positive number.
// CHECK-LABEL: tai.kernel @safe_quotients_grad(
//       CHECK:   %[[L:.+]] = tai.norm
//       CHECK:   %[[S:.+]] = arith.addf %[[L]]
//       CHECK:   arith.divf %{{.+}}, %[[S]]
//   CHECK-NOT:   arith.cmpf oeq, %{{.+}}, %{{.+}} : vector
//       CHECK:   tai.atomic add %{{.+}}, @x_grad
tai.kernel @safe_quotients() {
  %eps = arith.constant 1.0e-4 : f32
  %three = arith.constant 3.0 : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.divf %0, %three : f32
    %v = tai.load @v[%i] : vector<2xf32>
    %l = tai.norm %v : vector<2xf32>
    %s = arith.addf %l, %eps : f32
    %q = arith.divf %1, %s : f32
    tai.store %q, @y[%i] : f32
  }
  tai.return
}

// A product is finite where its factors are: no guard for loaded values, but one
// for a factor that a division made. (That is how NaN of an untaken arm would
// reach the other factor.)
// CHECK-LABEL: tai.kernel @products_grad(
//       CHECK:   %[[X:.+]] = tai.load @x[
//       CHECK:   %[[Y:.+]] = tai.load @y[
//       CHECK:   %[[Q:.+]] = arith.divf %[[X]], %[[Y]]
//       CHECK:   %[[G:.+]] = tai.load @z_grad
//       CHECK:   %[[GQ:.+]] = arith.mulf %[[G]], %[[Q]]
//       CHECK:   %[[C:.+]] = arith.cmpf oeq, %[[G]], %{{.+}}
//       CHECK:   arith.select %[[C]], %{{.+}}, %[[GQ]]
//       CHECK:   %[[GX:.+]] = arith.mulf %[[G]], %[[X]]
//   CHECK-NOT:   arith.select %{{.+}}, %{{.+}}, %[[GX]]
//       CHECK:   tai.return
tai.kernel @products() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %y = tai.load @y[%i] : f32
    %q = arith.divf %x, %y : f32
    %p = arith.mulf %x, %q : f32
    tai.store %p, @z[%i] : f32
  }
  tai.return
}

// Vectors are guarded component by component.
// CHECK-LABEL: tai.kernel @vectors_grad(
//       CHECK:   %[[C:.+]] = arith.cmpf oeq, %{{.+}}, %{{.+}} : vector<2xf32>
//       CHECK:   arith.select %[[C]], %{{.+}}, %{{.+}} : vector<2xi1>, vector<2xf32>
tai.kernel @vectors() {
  tai.parallel_for (%i) in @x {
    %v = tai.load @v[%i] : vector<2xf32>
    %l = math.log %v : vector<2xf32>
    %s = tai.sum %l : vector<2xf32>
    tai.store %s, @y[%i] : f32
  }
  tai.return
}

// Facts from ranges: 1 + exp(x), max(x, eps), 2 + sin(x), 1 + x^2, and
// quotients of them, cannot be zero.
// CHECK-LABEL: tai.kernel @ranges_grad(
//   CHECK-NOT:   arith.cmpf oeq
//       CHECK:   tai.return
tai.kernel @ranges() {
  %eps = arith.constant 1.0e-5 : f32
  %one = arith.constant 1.0 : f32
  %two = arith.constant 2.0 : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %y = tai.load @y[%i] : f32
    %t = math.tanh %x : f32
    %a = arith.maximumf %x, %eps : f32
    %0 = arith.divf %y, %a : f32
    %s = math.sin %y : f32
    %b = arith.addf %s, %two : f32
    %1 = math.log %b : f32
    %c = arith.subf %two, %t : f32
    %2 = math.rsqrt %c : f32
    %d = arith.mulf %a, %b : f32
    %3 = math.sqrt %d : f32
    %sq = arith.mulf %x, %x : f32
    %e = arith.addf %sq, %one : f32
    %f = arith.divf %one, %e : f32
    %n = arith.negf %e : f32
    %4 = arith.divf %f, %n : f32
    %5 = arith.addf %0, %1 : f32
    %6 = arith.addf %2, %3 : f32
    %7 = arith.addf %5, %6 : f32
    %8 = arith.addf %7, %4 : f32
    tai.store %8, @z[%i] : f32
  }
  tai.return
}

// These may vanish: 1 + sin(x), 1 - tanh(x), a number that is only not negative,
// and one that is positive, but so small that its inverse overflows.
// CHECK-LABEL: tai.kernel @may_vanish_grad(
// CHECK-COUNT-4: arith.cmpf oeq
//       CHECK:   tai.return
tai.kernel @may_vanish() {
  %tiny = arith.constant 1.0e-38 : f32
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %s = math.sin %x : f32
    %a = arith.addf %s, %one : f32
    %0 = math.sqrt %a : f32
    tai.store %0, @y[%i] : f32
  }
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %t = math.tanh %x : f32
    %b = arith.subf %one, %t : f32
    %1 = math.log %b : f32
    tai.store %1, @z[%i] : f32
  }
  tai.parallel_for (%i) in @v {
    %v = tai.load @v[%i] : vector<2xf32>
    %l = tai.norm %v : vector<2xf32>
    %2 = math.sqrt %l : f32
    tai.atomic add %2, @y[%i] : f32
  }
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %a = math.absf %x : f32
    %c = arith.addf %a, %tiny : f32
    %3 = math.rsqrt %c : f32
    tai.atomic add %3, @z[%i] : f32
  }
  tai.return
}

// A branch says what holds in it: the time of impact divides by a speed that is
// known to be large there.
// CHECK-LABEL: tai.kernel @conditions_grad(
//       CHECK:   scf.if
//   CHECK-NOT:   arith.cmpf oeq
//       CHECK:   tai.return
tai.kernel @conditions() {
  %zero = arith.constant 0.0 : f32
  %slow = arith.constant -1.0e-4 : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %y = tai.load @y[%i] : f32
    %low = arith.cmpf olt, %x, %zero : f32
    %fast = arith.cmpf olt, %y, %slow : f32
    %hits = arith.andi %low, %fast : i1
    %toi = scf.if %hits -> (f32) {
      %0 = arith.divf %x, %y : f32
      scf.yield %0 : f32
    } else {
      scf.yield %zero : f32
    }
    %p = arith.mulf %toi, %y : f32
    tai.store %p, @z[%i] : f32
  }
  tai.return
}

// Not so in the other arm, nor of a disjunction.
// CHECK-LABEL: tai.kernel @other_arm_grad(
//       CHECK:   arith.cmpf oeq
//       CHECK:   tai.return
tai.kernel @other_arm() {
  %zero = arith.constant 0.0 : f32
  %slow = arith.constant -1.0e-4 : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %y = tai.load @y[%i] : f32
    %low = arith.cmpf olt, %x, %zero : f32
    %fast = arith.cmpf olt, %y, %slow : f32
    %hits = arith.ori %low, %fast : i1
    %toi = scf.if %hits -> (f32) {
      %0 = arith.divf %x, %y : f32
      scf.yield %0 : f32
    } else {
      scf.yield %zero : f32
    }
    tai.store %toi, @z[%i] : f32
  }
  tai.return
}

// A vector by its length, or by 1 where that is zero, is at most 1 long; a vector
// with a component of 1 is at least that long.
// CHECK-LABEL: tai.kernel @normals_grad(
//   CHECK-NOT:   tai.guard
//       CHECK:   tai.return
// CHECK-LABEL: tai.kernel @other_vector_grad(
//       CHECK:   tai.guard
tai.kernel @normals() {
  %zero = arith.constant 0.0 : f32
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @x {
    %v = tai.load @v[%i] : vector<2xf32>
    %l = tai.norm %v : vector<2xf32>
    %none = arith.cmpf oeq, %l, %zero : f32
    %d = arith.select %none, %one, %l : f32
    %b = vector.broadcast %d : f32 to vector<2xf32>
    %u = arith.divf %v, %b : vector<2xf32>
    %s = tai.sum %u : vector<2xf32>
    %x = tai.load @x[%i] : f32
    %w = vector.from_elements %x, %one : vector<2xf32>
    %m = tai.norm %w : vector<2xf32>
    %q = arith.divf %s, %m : f32
    tai.store %q, @y[%i] : f32
  }
  tai.return
}
tai.kernel @other_vector() {
  %zero = arith.constant 0.0 : f32
  %one = arith.constant 1.0 : f32
  %two = arith.constant dense<2.0> : vector<2xf32>
  tai.parallel_for (%i) in @x {
    %v = tai.load @v[%i] : vector<2xf32>
    %l = tai.norm %v : vector<2xf32>
    %none = arith.cmpf oeq, %l, %zero : f32
    %d = arith.select %none, %one, %l : f32
    %b = vector.broadcast %d : f32 to vector<2xf32>
    %w = arith.addf %v, %two : vector<2xf32>
    %u = arith.divf %w, %b : vector<2xf32>
    %s = tai.sum %u : vector<2xf32>
    tai.store %s, @y[%i] : f32
  }
  tai.return
}
