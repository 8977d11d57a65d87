// RUN: tai-opt %s --tai-expand-atomics | FileCheck %s

!t = !tai.root<dense<[i: 8], {x: f32, x_grad: f32, n: i32, m: i32, m_grad: i32, plain: f32}>, dense<[i: 8], {v: vector<2x2xf32>, v_grad: vector<2x2xf32>}>, {s: f32, s_grad: f32}>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @v_grad = @t["v_grad"] : vector<2x2xf32>, rank 1
tai.field @s_grad = @t["s_grad"] : f32, rank 0
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @v = @t["v"] : vector<2x2xf32>, rank 1, adjoint @v_grad
tai.field @s = @t["s"] : f32, rank 0, adjoint @s_grad
tai.field @n = @t["n"] : i32, rank 1
tai.field @m_grad = @t["m_grad"] : i32, rank 1
tai.field @m = @t["m"] : i32, rank 1, adjoint @m_grad
tai.field @plain = @t["plain"] : f32, rank 1

// Each iteration has its own element. The new value wins a tie, by a choice whose
// sides cannot be exchanged.
// CHECK-LABEL: tai.kernel @exclusive(
//       CHECK:   %[[OLD:.+]] = tai.load @x[%[[I:.+]]] : f32
//       CHECK:   %[[GREATER:.+]] = arith.cmpf ogt, %[[OLD]], %[[A:.+]] : f32
//       CHECK:   %[[NAN:.+]] = arith.cmpf uno, %[[OLD]], %[[OLD]] : f32
//       CHECK:   %[[STAYS:.+]] = arith.ori %[[GREATER]], %[[NAN]] : i1
//       CHECK:   %[[NEW:.+]] = arith.select %[[STAYS]], %[[OLD]], %[[A]] : f32
//       CHECK:   tai.store %[[NEW]], @x[%[[I]]] : f32
//       CHECK:   %[[W:.+]] = tai.load @v[%[[I]]] : vector<2x2xf32>
//       CHECK:   %[[P:.+]] = arith.mulf %[[W]], %{{.+}} : vector<2x2xf32>
//       CHECK:   tai.store %[[P]], @v[%[[I]]] : vector<2x2xf32>
//   CHECK-NOT:   tai.atomic
tai.kernel @exclusive(%a: f32, %m: vector<2x2xf32>) {
  tai.parallel_for (%i) in @x {
    tai.atomic max %a, @x[%i] : f32
    tai.atomic mul %m, @v[%i] : vector<2x2xf32>
  }
  tai.return
}

// The result of an atomic is the loaded value, of integers too.
// CHECK-LABEL: tai.kernel @old(
//       CHECK:   %[[N:.+]] = tai.load @n[%[[I:.+]]] : i32
//       CHECK:   %[[O:.+]] = arith.ori %[[N]], %{{.+}} : i32
//       CHECK:   tai.store %[[O]], @n[%[[I]]] : i32
//       CHECK:   %[[X:.+]] = tai.load @x[%[[I]]] : f32
//       CHECK:   %[[D:.+]] = arith.subf %[[X]], %[[A:.+]] : f32
//       CHECK:   tai.store %[[D]], @x[%[[I]]] : f32
//       CHECK:   arith.index_cast %[[N]]
//       CHECK:   tai.store %[[X]], @plain
tai.kernel @old(%a: f32, %b: i32) {
  tai.parallel_for (%i) in @x {
    %0 = tai.atomic or %b, @n[%i] : i32
    %1 = tai.atomic sub %a, @x[%i] : f32
    %2 = arith.index_cast %0 : i32 to index
    tai.store %1, @plain[%2] : f32
  }
  tai.return
}

// Serial code and loops on one thread have every element to themselves.
// CHECK-LABEL: tai.kernel @serial(
//   CHECK-NOT:   tai.atomic
//       CHECK:   arith.cmpf olt
//       CHECK:   arith.select
//   CHECK-NOT:   tai.atomic
//       CHECK:   arith.mulf
//   CHECK-NOT:   tai.atomic
tai.kernel @serial(%a: f32) {
  tai.atomic min %a, @s[] : f32
  tai.parallel_for (%i) in @x serialize {
    tai.atomic mul %a, @s[] : f32
  }
  tai.return
}

// Sums, and what nobody differentiates, stay as they are.
// CHECK-LABEL: tai.kernel @kept(
//       CHECK:   tai.atomic add %{{.+}}, @x
//       CHECK:   tai.atomic sub %{{.+}}, @s
//       CHECK:   tai.atomic max %{{.+}}, @plain
//       CHECK:   tai.atomic xor %{{.+}}, @n
//   CHECK-NOT:   tai.load
tai.kernel @kept(%a: f32, %b: i32) {
  tai.parallel_for (%i) in @x {
    tai.atomic add %a, @x[%i] : f32
    tai.atomic sub %a, @s[] : f32
    tai.atomic max %a, @plain[%i] : f32
    tai.atomic xor %b, @n[%i] : i32
  }
  tai.return
}

// Contended: one for each component. An index that is the same for all is known
// before the loop.
// CHECK-LABEL: tai.kernel @contended(
//  CHECK-SAME:     %[[M:.+]]: vector<2x2xf32>, %[[T:.+]]: i32
//       CHECK:   %[[K:.+]] = arith.index_cast %[[T]]
//       CHECK:   tai.parallel_for
//       CHECK:     tai.atomic mul %{{.+}}, @v[%[[K]]] component{{.*}} : f32
//       CHECK:     tai.atomic mul
//       CHECK:     tai.atomic mul
//       CHECK:     tai.atomic mul
//   CHECK-NOT:     tai.atomic
tai.kernel @contended(%m: vector<2x2xf32>, %t: i32) {
  tai.parallel_for (%i) in @x {
    %k = arith.index_cast %t : i32 to index
    tai.atomic mul %m, @v[%k] : vector<2x2xf32>
  }
  tai.return
}

// Integers of all kinds, where the former value is used.
// CHECK-LABEL: tai.kernel @integers(
//  CHECK-SAME:     %[[B:.+]]: i32)
//       CHECK:   arith.addi %{{.+}}, %[[B]]
//       CHECK:   arith.subi
//       CHECK:   arith.muli
//       CHECK:   arith.minsi
//       CHECK:   arith.maxsi
//       CHECK:   arith.minui
//       CHECK:   arith.maxui
//       CHECK:   arith.andi
//       CHECK:   arith.xori
//   CHECK-NOT:   tai.atomic
tai.kernel @integers(%b: i32) {
  tai.parallel_for (%i) in @n {
    %0 = tai.atomic add %b, @n[%i] : i32
    %1 = tai.atomic sub %0, @n[%i] : i32
    %2 = tai.atomic mul %1, @n[%i] : i32
    %3 = tai.atomic min %2, @n[%i] : i32
    %4 = tai.atomic max %3, @n[%i] : i32
    %5 = tai.atomic minu %4, @n[%i] : i32
    %6 = tai.atomic maxu %5, @n[%i] : i32
    %7 = tai.atomic and %6, @n[%i] : i32
    %8 = tai.atomic xor %7, @n[%i] : i32
    tai.store %8, @m[%i] : i32
  }
  tai.return
}

// Halves of a tie are the same in any order.
// CHECK-LABEL: tai.kernel @shared_ties(
//       CHECK:   arith.maximumf
//       CHECK:   arith.minimumf
tai.kernel @shared_ties(%a: f32) attributes {conventions = {ties = "split"}} {
  tai.parallel_for (%i) in @x {
    tai.atomic max %a, @x[%i] : f32
    tai.atomic min %a, @x[%i] : f32
  }
  tai.return
}

// The former value of a contended vector is made of those of its components.
// CHECK-LABEL: tai.kernel @old_of_parts(
//       CHECK:     %[[A:.+]] = tai.atomic mul
//       CHECK:     %[[B:.+]] = tai.atomic mul
//       CHECK:     %[[C:.+]] = tai.atomic mul
//       CHECK:     %[[D:.+]] = tai.atomic mul
//       CHECK:     %[[OLD:.+]] = vector.from_elements %[[A]], %[[B]], %[[C]], %[[D]]
//       CHECK:     tai.sum %[[OLD]]
tai.kernel @old_of_parts(%w: vector<2x2xf32>) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.atomic mul %w, @v[%c0] : vector<2x2xf32>
    %1 = tai.sum %0 : vector<2x2xf32>
    tai.store %1, @plain[%i] : f32
  }
  tai.return
}

// Without an adjoint, a contended one stays whatever becomes of its result. An
// integer field has no derivative, whatever it names.
// CHECK-LABEL: tai.kernel @not_differentiated(
//       CHECK:   tai.parallel_for
//       CHECK:     tai.atomic max %{{.+}}, @plain
//       CHECK:     tai.atomic max %{{.+}}, @m
tai.kernel @not_differentiated(%a: f32, %b: i32) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.atomic max %a, @plain[%c0] : f32
    %1 = tai.atomic max %b, @m[%c0] : i32
    tai.store %0, @x[%i] : f32
    tai.store %1, @n[%i] : i32
  }
  tai.return
}
