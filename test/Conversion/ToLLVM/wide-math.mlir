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

// Powers of f32 with halves as exponents are products with a square root in
// f64. -infinity is apart, because its root is NaN.
// CHECK-LABEL: llvm.func @half_powers
//   CHECK-NOT:   llvm.intr.pow
//       CHECK:   %[[X:.+]] = llvm.fpext %{{.+}} : f32 to f64
//       CHECK:   %[[R:.+]] = llvm.intr.sqrt(%[[X]])
//       CHECK:   %[[P:.+]] = llvm.fmul %[[R]], %[[X]]
//       CHECK:   llvm.intr.fabs(%[[P]])
//       CHECK:   llvm.fcmp "oeq"
//       CHECK:   llvm.fptrunc
//       CHECK:   %[[V:.+]] = llvm.fpext %{{.+}} : vector<4xf32> to vector<4xf64>
//       CHECK:   llvm.intr.sqrt(%[[V]])
//       CHECK:   llvm.fdiv
//       CHECK:   llvm.return
// PLAIN-LABEL: llvm.func @half_powers
// PLAIN-COUNT-2: llvm.intr.pow
llvm.func @half_powers(%x: f32, %v: vector<4xf32>, %p: !llvm.ptr) attributes {passthrough = ["tai.lowered"]} {
  %y = arith.constant 1.5 : f32
  %z = arith.constant dense<-2.5> : vector<4xf32>
  %0 = math.powf %x, %y : f32
  %1 = math.powf %v, %z : vector<4xf32>
  llvm.store %0, %p : f32, !llvm.ptr
  llvm.store %1, %p : vector<4xf32>, !llvm.ptr
  llvm.return
}

// In f64, the errors of the root and of the product are added; they are NaN for
// zero and infinity, which the last selects leave as they are.
// CHECK-LABEL: llvm.func @half_powers_of_f64
//   CHECK-NOT:   llvm.intr.pow
//       CHECK:   %[[R:.+]] = llvm.intr.sqrt(%{{.+}}) : (f64) -> f64
//       CHECK:   llvm.intr.fma(%{{.+}}, %[[R]], %{{.+}}) : (f64, f64, f64) -> f64
//       CHECK:   %[[P:.+]] = llvm.fmul %[[R]], %{{.+}} : f64
//       CHECK:   llvm.intr.fma(%[[R]], %{{.+}}, %{{.+}}) : (f64, f64, f64) -> f64
//       CHECK:   llvm.fadd %[[P]], %{{.+}} : f64
//       CHECK:   llvm.return
llvm.func @half_powers_of_f64(%x: f64) -> f64 attributes {passthrough = ["tai.lowered"]} {
  %y = arith.constant 1.5 : f64
  %0 = math.powf %x, %y : f64
  llvm.return %0 : f64
}

// The inverse of a power of f64 may overflow where the power does not, and
// other exponents are no halves.
// CHECK-LABEL: llvm.func @other_powers
// CHECK-COUNT-3: llvm.intr.pow
llvm.func @other_powers(%x: f64, %s: f32, %e: f32, %p: !llvm.ptr) -> f64 attributes {passthrough = ["tai.lowered"]} {
  %y = arith.constant -1.5 : f64
  %z = arith.constant 1.25 : f32
  %0 = math.powf %x, %y : f64
  %1 = math.powf %s, %z : f32
  %2 = math.powf %s, %e : f32
  llvm.store %1, %p : f32, !llvm.ptr
  llvm.store %2, %p : f32, !llvm.ptr
  llvm.return %0 : f64
}
