// RUN: tai-opt %s --tai-make-adjoint --verify-diagnostics | FileCheck %s

// Products that are no functions of the matrix have the derivatives of the
// factors, with a warning. The others have none.

!m = vector<2x2xf64>
tai.tree @t : !tai.root<{a: !m, ga: !m, r: !m, gr: !m, v: vector<2xf64>, gv: vector<2xf64>, k: f64, n: i32}>
tai.field @ga = @t["ga"] : !m, rank 0
tai.field @gr = @t["gr"] : !m, rank 0
tai.field @gv = @t["gv"] : vector<2xf64>, rank 0
tai.field @a = @t["a"] : !m, rank 0, adjoint @ga
tai.field @r = @t["r"] : !m, rank 0, adjoint @gr
tai.field @v = @t["v"] : vector<2xf64>, rank 0, adjoint @gv

// The middle is not known to be diagonal: a position that is not known, a row, an
// argument, and a product of two full matrices.
tai.kernel @dynamic_insert(%i: index) {
  %zero = arith.constant 0.0 : f64
  %a = tai.load @a[] : !m
  // expected-warning @+2 {{where singular values are equal}}
  // expected-note @+1 {{products such as}}
  %u, %s, %v = tai.svd %a : !m
  %m = vector.insert %zero, %s [0, %i] : f64 into !m
  %0 = tai.matmul %u, %m : (!m, !m) -> !m
  %1 = tai.transpose %v : !m -> !m
  %2 = tai.matmul %0, %1 : (!m, !m) -> !m
  tai.store %2, @r[] : !m
  tai.return
}
tai.kernel @row_insert() {
  %zero = arith.constant dense<0.0> : vector<2xf64>
  %a = tai.load @a[] : !m
  // expected-warning @+2 {{where singular values are equal}}
  // expected-note @+1 {{products such as}}
  %u, %s, %v = tai.svd %a : !m
  %m = vector.insert %zero, %s [0] : vector<2xf64> into !m
  %0 = tai.matmul %u, %m : (!m, !m) -> !m
  %1 = tai.transpose %v : !m -> !m
  %2 = tai.matmul %0, %1 : (!m, !m) -> !m
  tai.store %2, @r[] : !m
  tai.return
}
tai.kernel @argument(%m: !m) {
  %a = tai.load @a[] : !m
  // expected-warning @+2 {{where singular values are equal}}
  // expected-note @+1 {{products such as}}
  %u, %s, %v = tai.svd %a : !m
  %0 = tai.matmul %u, %m : (!m, !m) -> !m
  %1 = tai.transpose %v : !m -> !m
  %2 = tai.matmul %0, %1 : (!m, !m) -> !m
  tai.store %2, @r[] : !m
  tai.return
}
tai.kernel @full_product(%m: !m) {
  %a = tai.load @a[] : !m
  // expected-warning @+2 {{where singular values are equal}}
  // expected-note @+1 {{products such as}}
  %u, %s, %v = tai.svd %a : !m
  %p = arith.mulf %a, %m : !m
  %0 = tai.matmul %u, %p : (!m, !m) -> !m
  %1 = tai.transpose %v : !m -> !m
  %2 = tai.matmul %0, %1 : (!m, !m) -> !m
  tai.store %2, @r[] : !m
  tai.return
}

// The end is no matrix, or no transpose of a factor, or its entries are scaled.
tai.kernel @vector_end() {
  %a = tai.load @a[] : !m
  %w = tai.load @v[] : vector<2xf64>
  // expected-warning @+2 {{where singular values are equal}}
  // expected-note @+1 {{products such as}}
  %u, %s, %v = tai.svd %a : !m
  %0 = tai.matmul %u, %s : (!m, !m) -> !m
  %2 = tai.matmul %0, %w : (!m, vector<2xf64>) -> vector<2xf64>
  tai.store %2, @v[] : vector<2xf64>
  tai.return
}
tai.kernel @eigenvalues() {
  %a = tai.load @a[] : !m
  // expected-warning @+2 {{where eigenvalues are equal}}
  // expected-note @+1 {{products such as}}
  %l, %q = tai.sym_eig %a : !m -> vector<2xf64>
  %2 = tai.matmul %q, %l : (!m, vector<2xf64>) -> vector<2xf64>
  tai.store %2, @v[] : vector<2xf64>
  tai.return
}
tai.kernel @not_transposed() {
  %a = tai.load @a[] : !m
  // expected-warning @+2 {{where singular values are equal}}
  // expected-note @+1 {{products such as}}
  %u, %s, %v = tai.svd %a : !m
  %0 = tai.matmul %u, %s : (!m, !m) -> !m
  %2 = tai.matmul %0, %u : (!m, !m) -> !m
  tai.store %2, @r[] : !m
  tai.return
}
tai.kernel @elementwise(%h: !m) {
  %a = tai.load @a[] : !m
  // expected-warning @+2 {{where singular values are equal}}
  // expected-note @+1 {{products such as}}
  %u, %s, %v = tai.svd %a : !m
  %uh = arith.mulf %u, %h : !m
  %0 = tai.matmul %uh, %s : (!m, !m) -> !m
  %1 = tai.transpose %v : !m -> !m
  %2 = tai.matmul %0, %1 : (!m, !m) -> !m
  tai.store %2, @r[] : !m
  tai.return
}

// The function cannot be extended: it reads a table at a position that the matrix
// decides, or takes what an earlier iteration left.
tai.kernel @by_table(%t: memref<4xf64>) {
  %zero = arith.constant 0.0 : f64
  %a = tai.load @a[] : !m
  // expected-warning @+2 {{where singular values are equal}}
  // expected-note @+1 {{products such as}}
  %u, %s, %v = tai.svd %a : !m
  %s0 = vector.extract %s[0, 0] : f64 from !m
  %i = arith.fptosi %s0 : f64 to i64
  %j = arith.index_cast %i : i64 to index
  %m0 = memref.load %t[%j] : memref<4xf64>
  %m = vector.from_elements %m0, %zero, %zero, %s0 : !m
  %0 = tai.matmul %u, %m : (!m, !m) -> !m
  %1 = tai.transpose %v : !m -> !m
  %2 = tai.matmul %0, %1 : (!m, !m) -> !m
  tai.store %2, @r[] : !m
  tai.return
}
tai.kernel @carried(%n: index) {
  %zero = arith.constant 0.0 : f64
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %a0 = tai.load @a[] : !m
  %q:2 = scf.for %i = %c0 to %n step %c1 iter_args(%a = %a0, %before = %zero) -> (!m, f64) {
    // expected-warning @+2 {{where singular values are equal}}
    // expected-note @+1 {{products such as}}
    %u, %s, %v = tai.svd %a : !m
    %s0 = vector.extract %s[0, 0] : f64 from !m
    %m = vector.from_elements %before, %zero, %zero, %s0 : !m
    %0 = tai.matmul %u, %m : (!m, !m) -> !m
    %1 = tai.transpose %v : !m -> !m
    %2 = tai.matmul %0, %1 : (!m, !m) -> !m
    scf.yield %2, %s0 : !m, f64
  }
  tai.store %q#0, @r[] : !m
  tai.return
}

// Choices of the kernel hold in the function.
// CHECK-LABEL: tai.kernel @shared_ties_grad(
//       CHECK:   %[[HALF:.+]] = arith.constant 5.000000e-01
//       CHECK:   arith.cmpf oeq
tai.kernel @shared_ties(%k: f64) attributes {conventions = {ties = "split"}} {
  %zero = arith.constant 0.0 : f64
  %c0 = arith.constant 0 : index
  %a = tai.load @a[] : !m
  %u, %s, %v = tai.svd %a : !m
  %s0 = vector.extract %s[0, 0] : f64 from !m
  %m0 = arith.maximumf %s0, %k : f64
  %m = vector.from_elements %m0, %zero, %zero, %s0 : !m
  %0 = tai.matmul %u, %m : (!m, !m) -> !m
  %1 = tai.transpose %v : !m -> !m
  %2 = tai.matmul %0, %1 : (!m, !m) -> !m
  tai.store %2, @r[] : !m
  tai.return
}

// A power by squares is no chain of very many factors, and what is known of a
// matrix is looked for once.
// CHECK-LABEL: tai.kernel @power_grad(
// CHECK-LABEL: tai.kernel @doubled_grad(
tai.kernel @power() {
  %a = tai.load @a[] : !m
  // expected-warning @+2 {{where singular values are equal}}
  // expected-note @+1 {{products such as}}
  %u, %s, %v = tai.svd %a : !m
  %p1 = tai.matmul %u, %u : (!m, !m) -> !m
  %p2 = tai.matmul %p1, %p1 : (!m, !m) -> !m
  %p3 = tai.matmul %p2, %p2 : (!m, !m) -> !m
  %p4 = tai.matmul %p3, %p3 : (!m, !m) -> !m
  %p5 = tai.matmul %p4, %p4 : (!m, !m) -> !m
  %p6 = tai.matmul %p5, %p5 : (!m, !m) -> !m
  %p7 = tai.matmul %p6, %p6 : (!m, !m) -> !m
  %p8 = tai.matmul %p7, %p7 : (!m, !m) -> !m
  %p9 = tai.matmul %p8, %p8 : (!m, !m) -> !m
  %p10 = tai.matmul %p9, %p9 : (!m, !m) -> !m
  %p11 = tai.matmul %p10, %p10 : (!m, !m) -> !m
  %p12 = tai.matmul %p11, %p11 : (!m, !m) -> !m
  %p13 = tai.matmul %p12, %p12 : (!m, !m) -> !m
  %p14 = tai.matmul %p13, %p13 : (!m, !m) -> !m
  %p15 = tai.matmul %p14, %p14 : (!m, !m) -> !m
  %p16 = tai.matmul %p15, %p15 : (!m, !m) -> !m
  %p17 = tai.matmul %p16, %p16 : (!m, !m) -> !m
  %p18 = tai.matmul %p17, %p17 : (!m, !m) -> !m
  %p19 = tai.matmul %p18, %p18 : (!m, !m) -> !m
  %p20 = tai.matmul %p19, %p19 : (!m, !m) -> !m
  %p21 = tai.matmul %p20, %p20 : (!m, !m) -> !m
  %p22 = tai.matmul %p21, %p21 : (!m, !m) -> !m
  %p23 = tai.matmul %p22, %p22 : (!m, !m) -> !m
  %p24 = tai.matmul %p23, %p23 : (!m, !m) -> !m
  %p25 = tai.matmul %p24, %p24 : (!m, !m) -> !m
  %p26 = tai.matmul %p25, %p25 : (!m, !m) -> !m
  %p27 = tai.matmul %p26, %p26 : (!m, !m) -> !m
  %p28 = tai.matmul %p27, %p27 : (!m, !m) -> !m
  %p29 = tai.matmul %p28, %p28 : (!m, !m) -> !m
  %p30 = tai.matmul %p29, %p29 : (!m, !m) -> !m
  %p31 = tai.matmul %p30, %p30 : (!m, !m) -> !m
  %p32 = tai.matmul %p31, %p31 : (!m, !m) -> !m
  tai.store %p32, @r[] : !m
  tai.return
}
tai.kernel @doubled() {
  %a = tai.load @a[] : !m
  %u, %s, %v = tai.svd %a : !m
  %p1 = arith.addf %s, %s : !m
  %p2 = arith.addf %p1, %p1 : !m
  %p3 = arith.addf %p2, %p2 : !m
  %p4 = arith.addf %p3, %p3 : !m
  %p5 = arith.addf %p4, %p4 : !m
  %p6 = arith.addf %p5, %p5 : !m
  %p7 = arith.addf %p6, %p6 : !m
  %p8 = arith.addf %p7, %p7 : !m
  %p9 = arith.addf %p8, %p8 : !m
  %p10 = arith.addf %p9, %p9 : !m
  %p11 = arith.addf %p10, %p10 : !m
  %p12 = arith.addf %p11, %p11 : !m
  %p13 = arith.addf %p12, %p12 : !m
  %p14 = arith.addf %p13, %p13 : !m
  %p15 = arith.addf %p14, %p14 : !m
  %p16 = arith.addf %p15, %p15 : !m
  %p17 = arith.addf %p16, %p16 : !m
  %p18 = arith.addf %p17, %p17 : !m
  %p19 = arith.addf %p18, %p18 : !m
  %p20 = arith.addf %p19, %p19 : !m
  %p21 = arith.addf %p20, %p20 : !m
  %p22 = arith.addf %p21, %p21 : !m
  %p23 = arith.addf %p22, %p22 : !m
  %p24 = arith.addf %p23, %p23 : !m
  %p25 = arith.addf %p24, %p24 : !m
  %p26 = arith.addf %p25, %p25 : !m
  %p27 = arith.addf %p26, %p26 : !m
  %p28 = arith.addf %p27, %p27 : !m
  %p29 = arith.addf %p28, %p28 : !m
  %p30 = arith.addf %p29, %p29 : !m
  %p31 = arith.addf %p30, %p30 : !m
  %p32 = arith.addf %p31, %p31 : !m
  %p33 = arith.addf %p32, %p32 : !m
  %p34 = arith.addf %p33, %p33 : !m
  %p35 = arith.addf %p34, %p34 : !m
  %p36 = arith.addf %p35, %p35 : !m
  %p37 = arith.addf %p36, %p36 : !m
  %p38 = arith.addf %p37, %p37 : !m
  %p39 = arith.addf %p38, %p38 : !m
  %p40 = arith.addf %p39, %p39 : !m
  %0 = tai.matmul %u, %p40 : (!m, !m) -> !m
  %1 = tai.transpose %v : !m -> !m
  %2 = tai.matmul %0, %1 : (!m, !m) -> !m
  tai.store %2, @r[] : !m
  tai.return
}
