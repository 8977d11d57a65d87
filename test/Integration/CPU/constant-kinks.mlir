// RUN: tai-run %s --no-cache | FileCheck %s
// RUN: tai-run %s --no-cache --opt-level=0 | FileCheck %s
// RUN: tai-run %s --interpret | FileCheck %s

// At kinks, operations on constants of the program have the values, by their
// bits, that they have on the same numbers from a field.
// CHECK-NOT: false
// CHECK-COUNT-21: true
// CHECK-NOT: false
tai.tree @data : !tai.root<dense<[i: 8], {x: f64}>>
tai.field @x = @data["x"] : f64, rank 1

tai.kernel @set(%i: index, %v: f64) {
  tai.store %v, @x[%i] : f64
  tai.return
}

tai.kernel @compare() {
  %i0 = arith.constant 0 : index
  %i1 = arith.constant 1 : index
  %i2 = arith.constant 2 : index
  %i3 = arith.constant 3 : index
  %i4 = arith.constant 4 : index
  %c0 = arith.constant 0.0 : f64
  %r0 = tai.load @x[%i0] : f64
  %c1 = arith.constant -0.0 : f64
  %r1 = tai.load @x[%i1] : f64
  %c2 = arith.constant 2.0 : f64
  %r2 = tai.load @x[%i2] : f64
  %c3 = arith.constant -2.0 : f64
  %r3 = tai.load @x[%i3] : f64
  %c4 = arith.constant 1.0 : f64
  %r4 = tai.load @x[%i4] : f64
  // atan2
  %a0 = math.atan2 %c0, %c0 : f64
  %b0 = math.atan2 %r0, %r0 : f64
  %ab0 = arith.bitcast %a0 : f64 to i64
  %bb0 = arith.bitcast %b0 : f64 to i64
  %e0 = arith.cmpi eq, %ab0, %bb0 : i64
  tai.print "atan2 {}"(%e0) : i1
  // atan2m
  %a1 = math.atan2 %c0, %c1 : f64
  %b1 = math.atan2 %r0, %r1 : f64
  %ab1 = arith.bitcast %a1 : f64 to i64
  %bb1 = arith.bitcast %b1 : f64 to i64
  %e1 = arith.cmpi eq, %ab1, %bb1 : i64
  tai.print "atan2m {}"(%e1) : i1
  // m_atan2
  %a2 = math.atan2 %c1, %c0 : f64
  %b2 = math.atan2 %r1, %r0 : f64
  %ab2 = arith.bitcast %a2 : f64 to i64
  %bb2 = arith.bitcast %b2 : f64 to i64
  %e2 = arith.cmpi eq, %ab2, %bb2 : i64
  tai.print "m_atan2 {}"(%e2) : i1
  // mm
  %a3 = math.atan2 %c1, %c1 : f64
  %b3 = math.atan2 %r1, %r1 : f64
  %ab3 = arith.bitcast %a3 : f64 to i64
  %bb3 = arith.bitcast %b3 : f64 to i64
  %e3 = arith.cmpi eq, %ab3, %bb3 : i64
  tai.print "mm {}"(%e3) : i1
  // pow00
  %a4 = math.powf %c0, %c0 : f64
  %b4 = math.powf %r0, %r0 : f64
  %ab4 = arith.bitcast %a4 : f64 to i64
  %bb4 = arith.bitcast %b4 : f64 to i64
  %e4 = arith.cmpi eq, %ab4, %bb4 : i64
  tai.print "pow00 {}"(%e4) : i1
  // pow-22
  %a5 = math.powf %c3, %c2 : f64
  %b5 = math.powf %r3, %r2 : f64
  %ab5 = arith.bitcast %a5 : f64 to i64
  %bb5 = arith.bitcast %b5 : f64 to i64
  %e5 = arith.cmpi eq, %ab5, %bb5 : i64
  tai.print "pow-22 {}"(%e5) : i1
  // pow02
  %a6 = math.powf %c0, %c2 : f64
  %b6 = math.powf %r0, %r2 : f64
  %ab6 = arith.bitcast %a6 : f64 to i64
  %bb6 = arith.bitcast %b6 : f64 to i64
  %e6 = arith.cmpi eq, %ab6, %bb6 : i64
  tai.print "pow02 {}"(%e6) : i1
  // sqrt0
  %a7 = math.sqrt %c1 : f64
  %b7 = math.sqrt %r1 : f64
  %ab7 = arith.bitcast %a7 : f64 to i64
  %bb7 = arith.bitcast %b7 : f64 to i64
  %e7 = arith.cmpi eq, %ab7, %bb7 : i64
  tai.print "sqrt0 {}"(%e7) : i1
  // max
  %a8 = arith.maximumf %c0, %c1 : f64
  %b8 = arith.maximumf %r0, %r1 : f64
  %ab8 = arith.bitcast %a8 : f64 to i64
  %bb8 = arith.bitcast %b8 : f64 to i64
  %e8 = arith.cmpi eq, %ab8, %bb8 : i64
  tai.print "max {}"(%e8) : i1
  // min
  %a9 = arith.minimumf %c0, %c1 : f64
  %b9 = arith.minimumf %r0, %r1 : f64
  %ab9 = arith.bitcast %a9 : f64 to i64
  %bb9 = arith.bitcast %b9 : f64 to i64
  %e9 = arith.cmpi eq, %ab9, %bb9 : i64
  tai.print "min {}"(%e9) : i1
  // log0
  %a10 = math.log %c0 : f64
  %b10 = math.log %r0 : f64
  %ab10 = arith.bitcast %a10 : f64 to i64
  %bb10 = arith.bitcast %b10 : f64 to i64
  %e10 = arith.cmpi eq, %ab10, %bb10 : i64
  tai.print "log0 {}"(%e10) : i1
  // rsqrt0
  %a11 = math.rsqrt %c0 : f64
  %b11 = math.rsqrt %r0 : f64
  %ab11 = arith.bitcast %a11 : f64 to i64
  %bb11 = arith.bitcast %b11 : f64 to i64
  %e11 = arith.cmpi eq, %ab11, %bb11 : i64
  tai.print "rsqrt0 {}"(%e11) : i1
  // clamp
  %a12 = math.clampf %c2 to [%c0, %c2] : f64
  %b12 = math.clampf %r2 to [%r0, %r2] : f64
  %ab12 = arith.bitcast %a12 : f64 to i64
  %bb12 = arith.bitcast %b12 : f64 to i64
  %e12 = arith.cmpi eq, %ab12, %bb12 : i64
  tai.print "clamp {}"(%e12) : i1
  // acos1
  %a13 = math.acos %c4 : f64
  %b13 = math.acos %r4 : f64
  %ab13 = arith.bitcast %a13 : f64 to i64
  %bb13 = arith.bitcast %b13 : f64 to i64
  %e13 = arith.cmpi eq, %ab13, %bb13 : i64
  tai.print "acos1 {}"(%e13) : i1
  // asin1
  %a14 = math.asin %c4 : f64
  %b14 = math.asin %r4 : f64
  %ab14 = arith.bitcast %a14 : f64 to i64
  %bb14 = arith.bitcast %b14 : f64 to i64
  %e14 = arith.cmpi eq, %ab14, %bb14 : i64
  tai.print "asin1 {}"(%e14) : i1
  // rem
  %a15 = arith.remf %c3, %c2 : f64
  %b15 = arith.remf %r3, %r2 : f64
  %ab15 = arith.bitcast %a15 : f64 to i64
  %bb15 = arith.bitcast %b15 : f64 to i64
  %e15 = arith.cmpi eq, %ab15, %bb15 : i64
  tai.print "rem {}"(%e15) : i1
  // copysign
  %a16 = math.copysign %c2, %c1 : f64
  %b16 = math.copysign %r2, %r1 : f64
  %ab16 = arith.bitcast %a16 : f64 to i64
  %bb16 = arith.bitcast %b16 : f64 to i64
  %e16 = arith.cmpi eq, %ab16, %bb16 : i64
  tai.print "copysign {}"(%e16) : i1
  // abs
  %a17 = math.absf %c1 : f64
  %b17 = math.absf %r1 : f64
  %ab17 = arith.bitcast %a17 : f64 to i64
  %bb17 = arith.bitcast %b17 : f64 to i64
  %e17 = arith.cmpi eq, %ab17, %bb17 : i64
  tai.print "abs {}"(%e17) : i1
  // div0
  %a18 = arith.divf %c2, %c1 : f64
  %b18 = arith.divf %r2, %r1 : f64
  %ab18 = arith.bitcast %a18 : f64 to i64
  %bb18 = arith.bitcast %b18 : f64 to i64
  %e18 = arith.cmpi eq, %ab18, %bb18 : i64
  tai.print "div0 {}"(%e18) : i1
  // sub
  %a19 = arith.subf %c1, %c0 : f64
  %b19 = arith.subf %r1, %r0 : f64
  %ab19 = arith.bitcast %a19 : f64 to i64
  %bb19 = arith.bitcast %b19 : f64 to i64
  %e19 = arith.cmpi eq, %ab19, %bb19 : i64
  tai.print "sub {}"(%e19) : i1
  // atanh
  %a20 = math.atanh %c4 : f64
  %b20 = math.atanh %r4 : f64
  %ab20 = arith.bitcast %a20 : f64 to i64
  %bb20 = arith.bitcast %b20 : f64 to i64
  %e20 = arith.cmpi eq, %ab20, %bb20 : i64
  tai.print "atanh {}"(%e20) : i1
  tai.return
}

func.func @main() {
  %i0 = arith.constant 0 : index
  %c0 = arith.constant 0.0 : f64
  tai.launch @set(%i0, %c0) : (index, f64) -> ()
  %i1 = arith.constant 1 : index
  %c1 = arith.constant -0.0 : f64
  tai.launch @set(%i1, %c1) : (index, f64) -> ()
  %i2 = arith.constant 2 : index
  %c2 = arith.constant 2.0 : f64
  tai.launch @set(%i2, %c2) : (index, f64) -> ()
  %i3 = arith.constant 3 : index
  %c3 = arith.constant -2.0 : f64
  tai.launch @set(%i3, %c3) : (index, f64) -> ()
  %i4 = arith.constant 4 : index
  %c4 = arith.constant 1.0 : f64
  tai.launch @set(%i4, %c4) : (index, f64) -> ()
  tai.launch @compare() : () -> ()
  return
}
