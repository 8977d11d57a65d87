// RUN: tai-opt %s --tai-forward-diff --cse | FileCheck %s --check-prefix=FORWARD
// RUN: tai-opt %s --tai-make-adjoint --cse | FileCheck %s

// The derivatives of the sum, product, least and greatest of the components of a
// vector.

!v = vector<3xf32>
tai.tree @t : !tai.root<dense<[i: 4], {v: !v, v_grad: !v, v_dual: !v, a: f32, a_grad: f32, a_dual: f32, y: f32, y_grad: f32, y_dual: f32}>>
tai.field @v_grad = @t["v_grad"] : !v, rank 1
tai.field @a_grad = @t["a_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @v_dual = @t["v_dual"] : !v, rank 1
tai.field @a_dual = @t["a_dual"] : f32, rank 1
tai.field @y_dual = @t["y_dual"] : f32, rank 1
tai.field @v = @t["v"] : !v, rank 1, adjoint @v_grad, dual @v_dual
tai.field @a = @t["a"] : f32, rank 1, adjoint @a_grad, dual @a_dual
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad, dual @y_dual

// FORWARD-LABEL: tai.kernel @sum_fwd()
//   FORWARD-DAG:   %[[DV:.+]] = tai.load @v_dual
//   FORWARD-DAG:   %[[DA:.+]] = tai.load @a_dual
//       FORWARD:   %[[DR:.+]] = vector.reduction <add>, %[[DV]], %[[DA]]
//       FORWARD:   tai.store %[[DR]], @y_dual
//   CHECK-LABEL: tai.kernel @sum_grad()
//         CHECK:   %[[G:.+]] = tai.load @y_grad
//         CHECK:   %[[ALL:.+]] = vector.broadcast %[[G]]
//     CHECK-DAG:   tai.atomic add %[[G]], @a_grad
//     CHECK-DAG:   tai.atomic add %[[ALL]], @v_grad
tai.kernel @sum() {
  tai.parallel_for (%i) in @y {
    %v = tai.load @v[%i] : !v
    %a = tai.load @a[%i] : f32
    %r = vector.reduction <add>, %v, %a : !v into f32
    tai.store %r, @y[%i] : f32
  }
  tai.return
}

// The product rule, from the first component on; and for each operand the
// product of all others.
// FORWARD-LABEL: tai.kernel @product_fwd()
//   FORWARD-DAG:   %[[A:.+]] = tai.load @a[
//   FORWARD-DAG:   %[[DA:.+]] = tai.load @a_dual
//       FORWARD:   %[[V0:.+]] = vector.extract %{{.+}}[0]
//       FORWARD:   %[[D0:.+]] = vector.extract %{{.+}}[0]
//       FORWARD:   %[[V1:.+]] = vector.extract %{{.+}}[1]
//       FORWARD:   %[[D1:.+]] = vector.extract %{{.+}}[1]
//       FORWARD:   %[[V2:.+]] = vector.extract %{{.+}}[2]
//       FORWARD:   %[[D2:.+]] = vector.extract %{{.+}}[2]
//       FORWARD:   %[[L1:.+]] = arith.mulf %[[D0]], %[[V1]]
//       FORWARD:   %[[R1:.+]] = arith.mulf %[[V0]], %[[D1]]
//       FORWARD:   %[[S1:.+]] = arith.addf %[[L1]], %[[R1]]
//       FORWARD:   %[[P1:.+]] = arith.mulf %[[V0]], %[[V1]]
//       FORWARD:   %[[L2:.+]] = arith.mulf %[[S1]], %[[V2]]
//       FORWARD:   %[[R2:.+]] = arith.mulf %[[P1]], %[[D2]]
//       FORWARD:   %[[S2:.+]] = arith.addf %[[L2]], %[[R2]]
//       FORWARD:   %[[P2:.+]] = arith.mulf %[[P1]], %[[V2]]
//       FORWARD:   %[[L3:.+]] = arith.mulf %[[S2]], %[[A]]
//       FORWARD:   %[[R3:.+]] = arith.mulf %[[P2]], %[[DA]]
//       FORWARD:   %[[S3:.+]] = arith.addf %[[L3]], %[[R3]]
//       FORWARD:   tai.store %[[S3]], @y_dual
//   CHECK-LABEL: tai.kernel @product_grad()
//         CHECK:   %[[A:.+]] = tai.load @a[
//         CHECK:   %[[G:.+]] = tai.load @y_grad
//         CHECK:   %[[V0:.+]] = vector.extract %{{.+}}[0]
//         CHECK:   %[[V1:.+]] = vector.extract %{{.+}}[1]
//         CHECK:   %[[V2:.+]] = vector.extract %{{.+}}[2]
//         CHECK:   %[[G0:.+]] = arith.mulf %[[G]], %[[V0]]
//         CHECK:   %[[G01:.+]] = arith.mulf %[[G0]], %[[V1]]
//     CHECK-DAG:   %[[GA:.+]] = arith.mulf %[[G01]], %[[V2]]
//     CHECK-DAG:   %[[G2:.+]] = arith.mulf %[[G01]], %[[A]]
//     CHECK-DAG:   %[[A2:.+]] = arith.mulf %[[A]], %[[V2]]
//     CHECK-DAG:   %[[G1:.+]] = arith.mulf %[[G0]], %[[A2]]
//     CHECK-DAG:   %[[A21:.+]] = arith.mulf %[[A2]], %[[V1]]
//     CHECK-DAG:   %[[GX:.+]] = arith.mulf %[[G]], %[[A21]]
//     CHECK-DAG:   tai.atomic add %[[GA]], @a_grad
//     CHECK-DAG:   %[[GV:.+]] = vector.from_elements %[[GX]], %[[G1]], %[[G2]]
//     CHECK-DAG:   tai.atomic add %[[GV]], @v_grad
tai.kernel @product() {
  tai.parallel_for (%i) in @y {
    %v = tai.load @v[%i] : !v
    %a = tai.load @a[%i] : f32
    %r = vector.reduction <mul>, %v, %a : !v into f32
    tai.store %r, @y[%i] : f32
  }
  tai.return
}

// The last one that equals the result has its tangent, and takes its adjoint.
// FORWARD-LABEL: tai.kernel @greatest_fwd()
//   FORWARD-DAG:   %[[A:.+]] = tai.load @a[
//   FORWARD-DAG:   %[[DA:.+]] = tai.load @a_dual
//       FORWARD:   %[[R:.+]] = vector.reduction <maximumf>
//       FORWARD:   %[[D0:.+]] = vector.extract %{{.+}}[0]
//       FORWARD:   %[[V1:.+]] = vector.extract %{{.+}}[1]
//       FORWARD:   %[[D1:.+]] = vector.extract %{{.+}}[1]
//       FORWARD:   %[[V2:.+]] = vector.extract %{{.+}}[2]
//       FORWARD:   %[[D2:.+]] = vector.extract %{{.+}}[2]
//       FORWARD:   %[[C1:.+]] = arith.cmpf oge, %[[V1]], %[[R]]
//       FORWARD:   %[[S1:.+]] = arith.select %[[C1]], %[[D1]], %[[D0]]
//       FORWARD:   %[[C2:.+]] = arith.cmpf oge, %[[V2]], %[[R]]
//       FORWARD:   %[[S2:.+]] = arith.select %[[C2]], %[[D2]], %[[S1]]
//       FORWARD:   %[[C3:.+]] = arith.cmpf oge, %[[A]], %[[R]]
//       FORWARD:   %[[S3:.+]] = arith.select %[[C3]], %[[DA]], %[[S2]]
//       FORWARD:   tai.store %[[S3]], @y_dual
//   CHECK-LABEL: tai.kernel @greatest_grad()
//         CHECK:   %[[A:.+]] = tai.load @a[
//         CHECK:   %[[R:.+]] = vector.reduction <maximumf>
//         CHECK:   %[[G:.+]] = tai.load @y_grad
//         CHECK:   %[[C:.+]] = arith.cmpf oge, %[[A]], %[[R]]
//     CHECK-DAG:   %[[GA:.+]] = arith.select %[[C]], %[[G]], %[[ZERO:.+]] : f32
//     CHECK-DAG:   %[[REST:.+]] = arith.select %[[C]], %[[ZERO]], %[[G]]
//         CHECK:   %[[C2:.+]] = arith.cmpf oge, %{{.+}}, %[[R]]
//         CHECK:   %[[G2:.+]] = arith.select %[[C2]], %[[REST]], %[[ZERO]]
//         CHECK:   tai.atomic add %[[GA]], @a_grad
//         CHECK:   vector.from_elements %{{.+}}, %{{.+}}, %[[G2]]
tai.kernel @greatest() {
  tai.parallel_for (%i) in @y {
    %v = tai.load @v[%i] : !v
    %a = tai.load @a[%i] : f32
    %r = vector.reduction <maximumf>, %v, %a : !v into f32
    tai.store %r, @y[%i] : f32
  }
  tai.return
}

// FORWARD-LABEL: tai.kernel @least_fwd()
//       FORWARD:   %[[R:.+]] = vector.reduction <minnumf>
//       FORWARD:   %[[D0:.+]] = vector.extract %{{.+}}[0]
//       FORWARD:   %[[C1:.+]] = arith.cmpf ole, %{{.+}}, %[[R]]
//       FORWARD:   %[[S1:.+]] = arith.select %[[C1]], %{{.+}}, %[[D0]]
//       FORWARD:   %[[C2:.+]] = arith.cmpf ole, %{{.+}}, %[[R]]
//       FORWARD:   %[[S2:.+]] = arith.select %[[C2]], %{{.+}}, %[[S1]]
//       FORWARD:   tai.store %[[S2]], @y_dual
//   CHECK-LABEL: tai.kernel @least_grad()
//         CHECK:   %[[R:.+]] = vector.reduction <minnumf>
// CHECK-COUNT-3:   arith.cmpf ole, %{{.+}}, %[[R]]
//         CHECK:   tai.return
tai.kernel @least() {
  tai.parallel_for (%i) in @y {
    %v = tai.load @v[%i] : !v
    %r = vector.reduction <minnumf>, %v : !v into f32
    tai.store %r, @y[%i] : f32
  }
  tai.return
}

// With the choice 'split', those that equal the result share. A factor that may
// be infinite takes nothing of a zero adjoint or tangent.
// FORWARD-LABEL: tai.kernel @shared_greatest_fwd()
//       FORWARD:   %[[R:.+]] = vector.reduction <maximumf>
//       FORWARD:   %[[C0:.+]] = arith.cmpf oge, %{{.+}}, %[[R]]
//       FORWARD:   %[[N0:.+]] = arith.select %[[C0]], %[[ONE:.+]], %{{.+}}
//       FORWARD:   %[[C1:.+]] = arith.cmpf oge, %{{.+}}, %[[R]]
//       FORWARD:   %[[N1:.+]] = arith.select %[[C1]], %[[ONE]],
//       FORWARD:   %[[N:.+]] = arith.addf %[[N0]], %[[N1]]
//       FORWARD:   arith.cmpf oge, %{{.+}}, %[[R]]
//       FORWARD:   %[[COUNT:.+]] = arith.addf %[[N]],
//       FORWARD:   %[[DR:.+]] = arith.divf %{{.+}}, %[[COUNT]]
//       FORWARD:   tai.store %[[DR]], @y_dual
//   CHECK-LABEL: tai.kernel @shared_greatest_grad()
//         CHECK:   %[[R:.+]] = vector.reduction <maximumf>
//         CHECK:   %[[G:.+]] = tai.load @y_grad
// CHECK-COUNT-3:   arith.cmpf oge, %{{.+}}, %[[R]]
//         CHECK:   %[[SHARE:.+]] = arith.divf %[[G]],
// CHECK-COUNT-3:   arith.select %{{.+}}, %[[SHARE]],
//         CHECK:   tai.return
tai.kernel @shared_greatest() attributes {conventions = {ties = "split"}} {
  tai.parallel_for (%i) in @y {
    %v = tai.load @v[%i] : !v
    %r = vector.reduction <maximumf>, %v : !v into f32
    tai.store %r, @y[%i] : f32
  }
  tai.return
}

// FORWARD-LABEL: tai.kernel @infinite_product_fwd()
//       FORWARD:   vector.reduction <mul>
// FORWARD-COUNT-4: arith.select %{{.+}} {tai.guard}
//   CHECK-LABEL: tai.kernel @infinite_product_grad()
//         CHECK:   %[[G:.+]] = tai.load @y_grad
//         CHECK:   %[[NONE:.+]] = arith.cmpf oeq, %[[G]],
// CHECK-COUNT-3:   arith.select %[[NONE]], %{{.+}} {tai.guard}
tai.kernel @infinite_product() {
  tai.parallel_for (%i) in @y {
    %v = tai.load @v[%i] : !v
    %a = tai.load @a[%i] : f32
    %b = vector.broadcast %a : f32 to !v
    %q = arith.divf %v, %b : !v
    %r = vector.reduction <mul>, %q : !v into f32
    tai.store %r, @y[%i] : f32
  }
  tai.return
}

// An accumulator alone may be infinite, and integers have no derivative.
//   CHECK-LABEL: tai.kernel @infinite_start_grad()
//         CHECK:   {tai.guard}
//   CHECK-LABEL: tai.kernel @integers_grad()
//     CHECK-NOT:   vector.reduction
//         CHECK:   tai.return
tai.kernel @infinite_start() {
  tai.parallel_for (%i) in @y {
    %v = tai.load @v[%i] : !v
    %a = tai.load @a[%i] : f32
    %l = math.log %a : f32
    %r = vector.reduction <mul>, %v, %l : !v into f32
    tai.store %r, @y[%i] : f32
  }
  tai.return
}
tai.kernel @integers() {
  tai.parallel_for (%i) in @y {
    %v = tai.load @v[%i] : !v
    %k = arith.fptosi %v : !v to vector<3xi32>
    %r = vector.reduction <maxsi>, %k : vector<3xi32> into i32
    %f = arith.sitofp %r : i32 to f32
    tai.store %f, @y[%i] : f32
  }
  tai.return
}
