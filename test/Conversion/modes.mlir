// RUN: tai-opt %s --tai-to-llvm | FileCheck %s
// RUN: tai-opt %s --pass-pipeline='builtin.module(tai.kernel(tai-widen-arithmetic))' | FileCheck %s --check-prefix=WIDE

tai.tree @s : !tai.root<dense<[i: 4096], {x: f32, y: f64}>, {t: f32, u: f64}>
tai.field @x = @s["x"] : f32, rank 1
tai.field @y = @s["y"] : f64, rank 1
tai.field @t = @s["t"] : f32, rank 0
tai.field @u = @s["u"] : f64, rank 0

// A kernel that says nothing has none of it: no control word, and sums of f32.
// CHECK-LABEL: llvm.func internal @plain.loop0
//   CHECK-NOT:   llvm.call_intrinsic
//       CHECK:   llvm.fadd {{.*}} : f32
//   CHECK-NOT:   mxcsr
tai.kernel @plain() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.atomic add %0, @t[] : f32
  }
  tai.return
}

// Terms are widened before they are added.
// CHECK-LABEL: llvm.func internal @compensated.loop0
//       CHECK:   llvm.fpext {{.*}} : f32 to f64
//       CHECK:   llvm.fadd {{.*}} : f64
//   CHECK-NOT:   llvm.fadd {{.*}} : f32
tai.kernel @compensated() attributes {modes = {sums = "compensated"}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.atomic add %0, @t[] : f32
  }
  tai.return
}

// Nothing is wider than f64: the rounding errors of the sum are summed beside
// it. No flag lets LLVM cancel that, and nothing is fused into it. The loop
// that LLVM vectorises stores its terms, and another one adds them up in lanes.
// CHECK-LABEL: llvm.func internal @pairs.loop0
//       CHECK:   %[[TERMS:.+]] = llvm.alloca %{{.+}} x vector<8xf64>
//       CHECK:   %[[TERM:.+]] = llvm.load %{{.+}} : !llvm.ptr -> f64
//       CHECK:   llvm.store %[[TERM]], %{{.+}} : f64
//       CHECK:   llvm.load {{.*}} : !llvm.ptr -> vector<8xf64>
//       CHECK:   %[[X:.+]] = llvm.call_intrinsic "llvm.arithmetic.fence"(%{{.+}}) : (vector<8xf64>)
//       CHECK:   %[[S:.+]] = llvm.fadd %{{.+}}, %[[X]] : vector<8xf64>
//       CHECK:   %[[T:.+]] = llvm.intr.fmuladd(%{{.+}}, %{{.+}}, %[[S]]) : (vector<8xf64>
//       CHECK:   llvm.fsub %[[X]], %[[T]] : vector<8xf64>
//       CHECK:   llvm.extractelement
tai.kernel @pairs() attributes {modes = {sums = "compensated"}} {
  tai.parallel_for (%i) in @y {
    %0 = tai.load @y[%i] : f64
    tai.atomic add %0, @u[] : f64
  }
  tai.return
}

// Terms of an inner loop are as many as it has iterations: they are added one
// after another.
// CHECK-LABEL: llvm.func internal @inner_pairs.loop0
//   CHECK-NOT:   vector<8xf64>
//   CHECK-NOT:   fence
//       CHECK:   %[[S:.+]] = llvm.fadd %[[P:.+]], %[[X:.+]] : f64
//  CHECK-NEXT:   %[[T:.+]] = llvm.fsub %[[S]], %[[P]] : f64
//       CHECK:   llvm.fsub %[[X]], %[[T]] : f64
tai.kernel @inner_pairs(%n: index) attributes {modes = {sums = "compensated"}} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @y {
    %0 = tai.load @y[%i] : f64
    scf.for %k = %c0 to %n step %c1 {
      tai.atomic add %0, @u[] : f64
    }
  }
  tai.return
}

// Each function that the runtime calls sets the control word and puts it back.
// CHECK-LABEL: llvm.func @flushing(
//       CHECK:   "llvm.{{x86.sse.stmxcsr|aarch64.get.fpcr}}"
//       CHECK:   llvm.call @flushing.flushing
//       CHECK:   "llvm.{{x86.sse.ldmxcsr|aarch64.set.fpcr}}"
//       CHECK:   llvm.return
//       CHECK: llvm.func internal @flushing.flushing({{.*}}no_inline
tai.kernel @flushing() attributes {modes = {ftz = true}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}

// A product and a sum stay two operations.
// CHECK-LABEL: llvm.func @strict(
//       CHECK:   llvm.fmul %{{.+}}, %{{.+}} : f32
//       CHECK:   llvm.fadd %{{.+}}, %{{.+}} : f32
tai.kernel @strict() attributes {modes = {math = "strict"}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    %2 = arith.addf %1, %0 : f32
    tai.store %2, @x[%i] : f32
  }
  tai.return
}

// The function of f32 is that of f64, rounded.
// CHECK-LABEL: llvm.func internal @accurate.loop0
//       CHECK:   llvm.intr.sin(%{{.+}}) {{.*}}: (f64) -> f64
tai.kernel @accurate() attributes {modes = {math = "accurate"}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}

// Locals, constants and what loops carry are wide; loads, stores and casts that
// the program makes keep their types.
// WIDE-LABEL: tai.kernel @wide(
//  WIDE-SAME:     %[[A:.+]]: f32)
//       WIDE:   %[[WA:.+]] = arith.extf %[[A]] : f32 to f64
//       WIDE:   arith.constant 5.000000e-01 : f64
//       WIDE:   %[[X:.+]] = tai.load @x[%{{.+}}] : f32
//       WIDE:   %[[WX:.+]] = arith.extf %[[X]] : f32 to f64
//       WIDE:   scf.for {{.*}} -> (f64)
//       WIDE:     arith.mulf {{.*}} : f64
//       WIDE:   %[[C:.+]] = arith.truncf %{{.+}} : f64 to f16
//       WIDE:   arith.extf %[[C]] : f16 to f64
//       WIDE:   tai.local_store %{{.+}}, %{{.+}} : f64
//       WIDE:   %[[R:.+]] = arith.truncf %{{.+}} : f64 to f32
//       WIDE:   tai.store %[[R]], @x
tai.kernel @wide(%a: f32) attributes {modes = {precision = "f64"}} {
  %half = arith.constant 0.5 : f32
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c9 = arith.constant 9 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = scf.for %k = %c0 to %c9 step %c1 iter_args(%s = %0) -> (f32) {
      %m = arith.mulf %s, %a : f32
      scf.yield %m : f32
    }
    %2 = arith.truncf %1 : f32 to f16
    %3 = arith.extf %2 : f16 to f32
    %4 = arith.mulf %3, %half : f32
    %l = tai.alloca : !tai.local<f32>
    tai.local_store %4, %l : f32
    %5 = tai.local_load %l : f32
    tai.store %5, @x[%i] : f32
  }
  tai.return
}
