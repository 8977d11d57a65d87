// RUN: tai-opt %s --tai-expand-atomics --tai-forward-diff --canonicalize --cse | FileCheck %s

// A tangent of zero stays zero where the other factor may be infinite.

!v = vector<3xf32>
tai.tree @t : !tai.root<dense<[i: 4], {a: !v, a_dual: !v, y: !v, y_dual: !v, s: f32, s_dual: f32, p: f32, p_dual: f32}>>
tai.field @a_dual = @t["a_dual"] : !v, rank 1
tai.field @y_dual = @t["y_dual"] : !v, rank 1
tai.field @a = @t["a"] : !v, rank 1, dual @a_dual
tai.field @y = @t["y"] : !v, rank 1, dual @y_dual
tai.field @s_dual = @t["s_dual"] : f32, rank 1
tai.field @s = @t["s"] : f32, rank 1, dual @s_dual
tai.field @p_dual = @t["p_dual"] : f32, rank 1
tai.field @p = @t["p"] : f32, rank 1, dual @p_dual

// Component i is a[j] b[k] - a[k] b[j], each product with a guard of its own.
// CHECK-LABEL: tai.kernel @cross_fwd(
//  CHECK-SAME:     %[[N:.+]]: vector<3xf32>
//       CHECK:   %[[B2:.+]] = vector.extract %[[B:.+]][2]
//       CHECK:   %[[N1:.+]] = vector.extract %[[N]][1]
//       CHECK:   %[[P:.+]] = arith.mulf %[[B2]], %[[N1]]
//       CHECK:   %[[Z1:.+]] = arith.cmpf oeq, %[[N1]], %[[ZERO:.+]] : f32
//       CHECK:   %[[G:.+]] = arith.select %[[Z1]], %[[ZERO]], %[[P]] {tai.guard}
//       CHECK:   %[[B1:.+]] = vector.extract %[[B]][1]
//       CHECK:   %[[N2:.+]] = vector.extract %[[N]][2]
//       CHECK:   %[[Q:.+]] = arith.mulf %[[B1]], %[[N2]]
//       CHECK:   %[[H:.+]] = arith.select %{{.+}}, %[[ZERO]], %[[Q]] {tai.guard}
//       CHECK:   %[[X:.+]] = arith.subf %[[G]], %[[H]]
//       CHECK:   %[[Y:.+]] = arith.subf
//       CHECK:   %[[W:.+]] = arith.subf
//       CHECK:   %[[ALL:.+]] = vector.from_elements %[[X]], %[[Y]], %[[W]]
//       CHECK:   tai.store %[[ALL]], @y_dual
tai.kernel @cross(%n: !v) {
  tai.parallel_for (%i) in @y {
    %a = tai.load @a[%i] : !v
    %b = math.exp %a : !v
    %r = tai.cross %n, %b : !v
    tai.store %r, @y[%i] : !v
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @product_fwd()
//       CHECK:   %[[OLD:.+]] = tai.load @p_dual
//       CHECK:   %[[KEPT:.+]] = arith.mulf %[[OLD]], %[[E:.+]] : f32
//       CHECK:   %[[IS:.+]] = arith.cmpf oeq, %[[OLD]], %[[ZERO:.+]] : f32
//       CHECK:   %[[SAFE:.+]] = arith.select %[[IS]], %[[ZERO]], %[[KEPT]] {tai.guard}
//       CHECK:   %[[SUM:.+]] = arith.addf %[[SAFE]], %{{.+}}
//       CHECK:   tai.store %[[SUM]], @p_dual
tai.kernel @product() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @s {
    %x = tai.load @s[%i] : f32
    %e = math.log %x : f32
    tai.atomic mul %e, @p[%c0] : f32
  }
  tai.return
}
