// RUN: tai-opt %s --tai-to-nvvm=fast-math=true | tai-translate --tai-to-ptx --device-floats=fast | FileCheck %s --check-prefix=FAST
// RUN: tai-opt %s --tai-to-nvvm | tai-translate --tai-to-ptx | FileCheck %s

// The quickest quotient of a GPU is wrong for large divisors, and a GPU flushes
// denormals of f32 only.

tai.tree @t : !tai.root<dense<[i: 64], {x: f32, y: f32, z: f32}>, dense<[i: 64], {d: f64}>, dense<[i: 100000], {many: f32}>, dense<[i: 1000], {few: f32}>, {sum: f32, other: f32}>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @z = @t["z"] : f32, rank 1
tai.field @d = @t["d"] : f64, rank 1
tai.field @many = @t["many"] : f32, rank 1
tai.field @few = @t["few"] : f32, rank 1
tai.field @sum = @t["sum"] : f32, rank 0
tai.field @other = @t["other"] : f32, rank 0

// FAST-LABEL: .entry quotient_0(
// FAST:       div.full.f32
// CHECK-LABEL: .entry quotient_0(
// CHECK:       div.rn.f32
tai.kernel @quotient() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @y[%i] : f32
    %2 = arith.divf %0, %1 : f32
    tai.store %2, @z[%i] : f32
  }
  tai.return
}

// Two quotients by one number are products with its reciprocal.
// FAST-LABEL: .entry quotients_0(
// FAST-NOT:   div.full.f32
// FAST-LABEL: .entry reciprocal_0(
// FAST:       rcp.approx.f32
tai.kernel @quotients() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @y[%i] : f32
    %2 = arith.divf %0, %1 : f32
    %c = arith.constant 3.0 : f32
    %3 = arith.addf %0, %c : f32
    %4 = arith.divf %3, %1 : f32
    tai.store %2, @z[%i] : f32
    tai.store %4, @y[%i] : f32
  }
  tai.return
}
tai.kernel @reciprocal() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %one = arith.constant 1.0 : f32
    %1 = arith.divf %one, %0 : f32
    tai.store %1, @z[%i] : f32
  }
  tai.return
}

// Operands and results of f64 become zero by a comparison.
// CHECK-LABEL: .entry flushing_0(
// CHECK:       setp.lt.f64 {{.+}}, 0d0010000000000000;
// CHECK:       mul.{{(rn.)?}}f64
// CHECK:       setp.lt.f64 {{.+}}, 0d0010000000000000;
// CHECK:       st.global
tai.kernel @flushing() attributes {modes = {ftz = true}} {
  tai.parallel_for (%i) in @d {
    %0 = tai.load @d[%i] : f64
    %1 = arith.mulf %0, %0 : f64
    tai.store %1, @d[%i] : f64
  }
  tai.return
}
// CHECK-LABEL: .entry flushing32_0(
// CHECK:       mul.{{(rn.)?}}ftz.f32
tai.kernel @flushing32() attributes {modes = {ftz = true}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}

// Blocks of a long loop add to an f64, which one thread rounds; those of a
// short one to the element.
// CHECK-LABEL: .entry total_0(
// CHECK:       .global{{(.relaxed|.gpu)*}}.add.f64
// CHECK-LABEL: .entry total_1(
// CHECK:       ld.global{{(.[a-z0-9]+)*}}.b64
// CHECK:       cvt.rn.f32.f64
// CHECK:       .add.f32
tai.kernel @total() {
  tai.parallel_for (%i) in @many {
    %0 = tai.load @many[%i] : f32
    tai.atomic add %0, @sum[] : f32
  }
  tai.return
}
// CHECK-LABEL: .entry short_0(
// CHECK-NOT:   add.f64 [
// CHECK-NOT:   .entry short_1(
tai.kernel @short() {
  tai.parallel_for (%i) in @few {
    %0 = tai.load @few[%i] : f32
    tai.atomic add %0, @other[] : f32
  }
  tai.return
}
