// RUN: tai-opt %s --tai-autodiff --verify-diagnostics | FileCheck %s
// RUN: tai-opt %s --tai-forward-diff --canonicalize --verify-diagnostics | FileCheck %s --check-prefix=FORWARD

tai.tree @t : !tai.root<{a: vector<2x2xf64>, a_grad: vector<2x2xf64>, a_dual: vector<2x2xf64>,
                         r: vector<2x2xf64>, r_grad: vector<2x2xf64>, r_dual: vector<2x2xf64>}>
tai.field @a_grad = @t["a_grad"] : vector<2x2xf64>, rank 0
tai.field @r_grad = @t["r_grad"] : vector<2x2xf64>, rank 0
tai.field @a_dual = @t["a_dual"] : vector<2x2xf64>, rank 0
tai.field @r_dual = @t["r_dual"] : vector<2x2xf64>, rank 0
tai.field @a = @t["a"] : vector<2x2xf64>, rank 0, adjoint @a_grad, dual @a_dual
tai.field @r = @t["r"] : vector<2x2xf64>, rank 0, adjoint @r_grad, dual @r_dual

// U f(S) V' with f(s) = s * s is differentiated as a function of the matrix: by
// quotients of differences, or the derivative 2 s where these are no more than
// rounding. The kernel itself stays as it was.
// CHECK-LABEL: tai.kernel @square()
//   CHECK-NOT:   stop_gradient
//       CHECK:   tai.return
// CHECK-LABEL: tai.kernel @square_grad()
//       CHECK:   %[[U:.+]], %[[S:.+]], %[[V:.+]] = tai.svd
//       CHECK:   %[[BY:.+]] = arith.divf
//       CHECK:   %[[FAR:.+]] = arith.select %{{.+}}, %{{.+}}, %[[BY]] : f64
//       CHECK:   arith.select %{{.+}}, %{{.+}}, %[[FAR]] : f64
//   CHECK-NOT:   derive_as
//       CHECK:   tai.return
// FORWARD-LABEL: tai.kernel @square_fwd()
//       FORWARD:   arith.select
//   FORWARD-NOT:   derive_as
//       FORWARD:   tai.return
tai.kernel @square() {
  %zero = arith.constant 0.0 : f64
  %a = tai.load @a[] : vector<2x2xf64>
  %u, %s, %v = tai.svd %a : vector<2x2xf64>
  %s0 = vector.extract %s[0, 0] : f64 from vector<2x2xf64>
  %s1 = vector.extract %s[1, 1] : f64 from vector<2x2xf64>
  %m0 = arith.mulf %s0, %s0 : f64
  %m1 = arith.mulf %s1, %s1 : f64
  %m = vector.from_elements %m0, %zero, %zero, %m1 : vector<2x2xf64>
  %0 = tai.matmul %u, %m : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  %1 = tai.transpose %v : vector<2x2xf64> -> vector<2x2xf64>
  %2 = tai.matmul %0, %1 : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  tai.store %2, @r[] : vector<2x2xf64>
  tai.return
}

// A factor by itself turns where it wants to.
tai.kernel @factor() {
  %a = tai.load @a[] : vector<2x2xf64>
  // expected-warning @+2 {{where singular values are equal, the derivatives of U and V by themselves do not exist and are taken as zero}}
  // expected-note @+1 {{products such as U f(Σ) Vᵀ written with '@' are differentiated as functions of the matrix and are right everywhere}}
  %u, %s, %v = tai.svd %a : vector<2x2xf64>
  tai.store %u, @r[] : vector<2x2xf64>
  tai.return
}

// So do eigenvectors; with a matrix that is not diagonal, too.
tai.kernel @full() {
  %a = tai.load @a[] : vector<2x2xf64>
  // expected-warning @+2 {{where eigenvalues are equal, the derivatives of the eigenvectors do not exist and are taken as zero}}
  // expected-note @+1 {{products such as}}
  %l, %q = tai.sym_eig %a : vector<2x2xf64> -> vector<2xf64>
  %0 = tai.matmul %q, %a : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  %1 = tai.transpose %q : vector<2x2xf64> -> vector<2x2xf64>
  %2 = tai.matmul %0, %1 : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  tai.store %2, @r[] : vector<2x2xf64>
  tai.return
}

// The values alone are known everywhere.
// CHECK-LABEL: tai.kernel @values_grad()
//   CHECK-NOT:   arith.divf
//       CHECK:   tai.return
tai.kernel @values() {
  %a = tai.load @a[] : vector<2x2xf64>
  %u, %s, %v = tai.svd %a : vector<2x2xf64>
  tai.store %s, @r[] : vector<2x2xf64>
  tai.return
}

// A matrix in the middle is diagonal by the ops that make it: inserts on the
// diagonal, or of zero, and a quotient of a diagonal one.
tai.kernel @inserts() {
  %zero = arith.constant 0.0 : f64
  %two = arith.constant dense<2.0> : vector<2x2xf64>
  %zeros = arith.constant dense<0.0> : vector<2x2xf64>
  %a = tai.load @a[] : vector<2x2xf64>
  %u, %s, %v = tai.svd %a : vector<2x2xf64>
  %s0 = vector.extract %s[0, 0] : f64 from vector<2x2xf64>
  %s1 = vector.extract %s[1, 1] : f64 from vector<2x2xf64>
  %d = vector.insert %s0, %zeros[0, 0] : f64 into vector<2x2xf64>
  %m = vector.insert %s1, %d[1, 1] : f64 into vector<2x2xf64>
  %0 = tai.matmul %u, %m : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  %1 = tai.transpose %v : vector<2x2xf64> -> vector<2x2xf64>
  %2 = tai.matmul %0, %1 : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  tai.store %2, @r[] : vector<2x2xf64>
  tai.return
}
tai.kernel @quotient() {
  %zero = arith.constant 0.0 : f64
  %two = arith.constant dense<2.0> : vector<2x2xf64>
  %zeros = arith.constant dense<0.0> : vector<2x2xf64>
  %a = tai.load @a[] : vector<2x2xf64>
  %u, %s, %v = tai.svd %a : vector<2x2xf64>
  %s0 = vector.extract %s[0, 0] : f64 from vector<2x2xf64>
  %s1 = vector.extract %s[1, 1] : f64 from vector<2x2xf64>
  %m = arith.divf %s, %two : vector<2x2xf64>
  %0 = tai.matmul %u, %m : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  %1 = tai.transpose %v : vector<2x2xf64> -> vector<2x2xf64>
  %2 = tai.matmul %0, %1 : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  tai.store %2, @r[] : vector<2x2xf64>
  tai.return
}
tai.kernel @insert_of_zero() {
  %zero = arith.constant 0.0 : f64
  %two = arith.constant dense<2.0> : vector<2x2xf64>
  %zeros = arith.constant dense<0.0> : vector<2x2xf64>
  %a = tai.load @a[] : vector<2x2xf64>
  %u, %s, %v = tai.svd %a : vector<2x2xf64>
  %s0 = vector.extract %s[0, 0] : f64 from vector<2x2xf64>
  %s1 = vector.extract %s[1, 1] : f64 from vector<2x2xf64>
  %m = vector.insert %zero, %s[0, 1] : f64 into vector<2x2xf64>
  %0 = tai.matmul %u, %m : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  %1 = tai.transpose %v : vector<2x2xf64> -> vector<2x2xf64>
  %2 = tai.matmul %0, %1 : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  tai.store %2, @r[] : vector<2x2xf64>
  tai.return
}

// It is not if something else stands off its diagonal, or is the dividend.
tai.kernel @insert_off_the_diagonal() {
  %zero = arith.constant 0.0 : f64
  %two = arith.constant dense<2.0> : vector<2x2xf64>
  %zeros = arith.constant dense<0.0> : vector<2x2xf64>
  %a = tai.load @a[] : vector<2x2xf64>
  // expected-warning @+2 {{where singular values are equal}}
  // expected-note @+1 {{products such as}}
  %u, %s, %v = tai.svd %a : vector<2x2xf64>
  %s0 = vector.extract %s[0, 0] : f64 from vector<2x2xf64>
  %s1 = vector.extract %s[1, 1] : f64 from vector<2x2xf64>
  %d = vector.insert %s0, %zeros[0, 1] : f64 into vector<2x2xf64>
  %m = vector.insert %s1, %d[1, 1] : f64 into vector<2x2xf64>
  %0 = tai.matmul %u, %m : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  %1 = tai.transpose %v : vector<2x2xf64> -> vector<2x2xf64>
  %2 = tai.matmul %0, %1 : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  tai.store %2, @r[] : vector<2x2xf64>
  tai.return
}
tai.kernel @divided() {
  %zero = arith.constant 0.0 : f64
  %two = arith.constant dense<2.0> : vector<2x2xf64>
  %zeros = arith.constant dense<0.0> : vector<2x2xf64>
  %a = tai.load @a[] : vector<2x2xf64>
  // expected-warning @+2 {{where singular values are equal}}
  // expected-note @+1 {{products such as}}
  %u, %s, %v = tai.svd %a : vector<2x2xf64>
  %s0 = vector.extract %s[0, 0] : f64 from vector<2x2xf64>
  %s1 = vector.extract %s[1, 1] : f64 from vector<2x2xf64>
  %m = arith.divf %two, %s : vector<2x2xf64>
  %0 = tai.matmul %u, %m : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  %1 = tai.transpose %v : vector<2x2xf64> -> vector<2x2xf64>
  %2 = tai.matmul %0, %1 : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  tai.store %2, @r[] : vector<2x2xf64>
  tai.return
}

// A factor in front of U f(S) V' takes the value of the function into its
// adjoint: f(S) on the diagonal, enclosed by U and V.
// CHECK-LABEL: tai.kernel @times_grad(
//       CHECK:   %[[U:.+]], %[[S:.+]], %[[V:.+]] = tai.svd
//       CHECK:   %[[S0:.+]] = vector.extract %[[S]][0, 0]
//       CHECK:   %[[S1:.+]] = vector.extract %[[S]][1, 1]
//       CHECK:   %[[M0:.+]] = arith.mulf %[[S0]], %[[S0]]
//       CHECK:   %[[M1:.+]] = arith.mulf %[[S1]], %[[S1]]
//       CHECK:   vector.from_elements %[[M0]], %[[ZERO:.+]], %[[ZERO]], %[[M1]]
//       CHECK:   tai.return
tai.kernel @times(%b: vector<2x2xf64>) {
  %zero = arith.constant 0.0 : f64
  %a = tai.load @a[] : vector<2x2xf64>
  %u, %s, %v = tai.svd %a : vector<2x2xf64>
  %s0 = vector.extract %s[0, 0] : f64 from vector<2x2xf64>
  %s1 = vector.extract %s[1, 1] : f64 from vector<2x2xf64>
  %m0 = arith.mulf %s0, %s0 : f64
  %m1 = arith.mulf %s1, %s1 : f64
  %m = vector.from_elements %m0, %zero, %zero, %m1 : vector<2x2xf64>
  %c = tai.load @a[] : vector<2x2xf64>
  %cu = tai.matmul %c, %u : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  %0 = tai.matmul %cu, %m : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  %1 = tai.transpose %v : vector<2x2xf64> -> vector<2x2xf64>
  %2 = tai.matmul %0, %1 : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
  tai.store %2, @r[] : vector<2x2xf64>
  tai.return
}
