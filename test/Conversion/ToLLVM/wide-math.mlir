// RUN: tai-opt %s --tai-convert-to-llvm | FileCheck %s
// RUN: tai-opt %s --tai-convert-to-llvm=contract=false | FileCheck %s --check-prefix=PLAIN

// The exponential, the logarithm and the hyperbolic tangent of f32 are
// arithmetic in f64, which vectorises; without contraction they are those of
// libm, and those of f64 always. The tangent keeps the sign of a zero.
// CHECK-LABEL: llvm.func @wide
//   CHECK-NOT:   llvm.intr.exp
//   CHECK-NOT:   llvm.call
//       CHECK:   llvm.fpext %{{.+}} : f32 to f64
//       CHECK:   llvm.fadd %{{.+}} {fastmathFlags = #llvm.fastmath<contract>} : f64
//       CHECK:   llvm.fptrunc %{{.+}} : f64 to f32
//       CHECK:   llvm.intr.fabs(%{{.+}}) : (f32) -> f32
//       CHECK:   llvm.fdiv %{{.+}} {fastmathFlags = #llvm.fastmath<contract>} : f64
//       CHECK:   llvm.intr.copysign
//       CHECK:   llvm.ashr
//       CHECK:   llvm.fpext %{{.+}} : vector<4xf32> to vector<4xf64>
//       CHECK:   llvm.intr.exp(%{{.+}}) {{.*}}: (f64) -> f64
// PLAIN-LABEL: llvm.func @wide
//       PLAIN:   llvm.intr.exp(%{{.+}}) : (f32) -> f32
//       PLAIN:   llvm.intr.tanh(%{{.+}}) : (f32) -> f32
//       PLAIN:   llvm.intr.log(%{{.+}}) : (f32) -> f32
//       PLAIN:   llvm.intr.exp(%{{.+}}) : (vector<4xf32>) -> vector<4xf32>
//       PLAIN:   llvm.intr.exp(%{{.+}}) : (f64) -> f64
llvm.func @wide(%x: f32, %v: vector<4xf32>, %d: f64, %p: !llvm.ptr) -> f64 attributes {passthrough = ["tai.lowered"]} {
  %0 = math.exp %x : f32
  %1 = math.tanh %0 : f32
  %2 = math.log %1 : f32
  %3 = math.exp %v : vector<4xf32>
  llvm.store %2, %p : f32, !llvm.ptr
  llvm.store %3, %p : vector<4xf32>, !llvm.ptr
  %4 = math.exp %d : f64
  llvm.return %4 : f64
}

// So are those to the base of 2: a power is 2^k e^(r ln 2), and the logarithm
// of a power of 2 is its exponent.
// CHECK-LABEL: llvm.func @base_of_two
//   CHECK-NOT:   llvm.intr
//       CHECK:   llvm.fptrunc %{{.+}} : f64 to f32
//   CHECK-NOT:   llvm.intr
//       CHECK:   llvm.fptrunc %{{.+}} : f64 to f32
//       CHECK:   llvm.intr.log2(%{{.+}}) {{.*}}: (f64) -> f64
// PLAIN-LABEL: llvm.func @base_of_two
//       PLAIN:   llvm.intr.exp2(%{{.+}}) : (f32) -> f32
//       PLAIN:   llvm.intr.log2(%{{.+}}) : (f32) -> f32
llvm.func @base_of_two(%x: f32, %d: f64, %p: !llvm.ptr) -> f64 attributes {passthrough = ["tai.lowered"]} {
  %0 = math.exp2 %x : f32
  %1 = math.log2 %0 : f32
  llvm.store %1, %p : f32, !llvm.ptr
  %2 = math.log2 %d : f64
  llvm.return %2 : f64
}
