// RUN: tai-opt %s --tai-to-nvvm=fast-math=true | tai-translate --tai-to-ptx --device-floats=fast | FileCheck %s --check-prefix=FAST

// The approximate instructions of a GPU are wrong far from zero, and for powers
// of numbers that are not positive. No library is needed, nor called.
// FAST-NOT: .extern

tai.tree @t : !tai.root<dense<[i: 64], {x: f32, y: f32, z: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @z = @t["z"] : f32, rank 1

// Multiples of 2 pi go in three parts; nothing is flushed.
// FAST-LABEL: .entry sine_0(
// FAST:       cvt.rni.f32.f32 [[K:%r[0-9]+]],
// FAST-NEXT:  fma.rn.f32 [[A:%r[0-9]+]], [[K]], 0fC0C90000, %r{{[0-9]+}};
// FAST-NEXT:  fma.rn.f32 [[B:%r[0-9]+]], [[K]], 0fBAFDA000, [[A]];
// FAST-NEXT:  fma.rn.f32 [[C:%r[0-9]+]], [[K]], 0fB4A22169, [[B]];
// FAST-NEXT:  sin.approx.f32 %r{{[0-9]+}}, [[C]];
tai.kernel @sine() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @y[%i] : f32
  }
  tai.return
}

// The power of the size, its sign, NaN of a broken power, and one.
// FAST-LABEL: .entry power_0(
// FAST:       abs.f32
// FAST:       lg2.approx.f32
// FAST:       ex2.approx.f32
// FAST:       selp.f32 %r{{[0-9]+}}, %r{{[0-9]+}}, 0f7FC00000
// FAST:       selp.f32 %r{{[0-9]+}}, 0f3F800000
tai.kernel @power() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @y[%i] : f32
    %2 = math.powf %0, %1 : f32
    tai.store %2, @z[%i] : f32
  }
  tai.return
}
