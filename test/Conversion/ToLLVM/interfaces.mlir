// RUN: tai-opt %s --tai-to-llvm | FileCheck %s
// RUN: tai-opt %s --tai-to-nvvm | FileCheck %s --check-prefix=DEVICE
// RUN: tai-opt %s --tai-to-llvm | tai-translate --mlir-to-llvmir | FileCheck %s --check-prefix=IR

// Dialects with upstream's ConvertToLLVMPatternInterface are converted by their
// own patterns, beside those of tai.

tai.tree @t : !tai.root<dense<[i: 64], {x: f64, y: f64}>>
tai.field @x = @t["x"] : f64, rank 1
tai.field @y = @t["y"] : f64, rank 1

//  CHECK-LABEL: llvm.func @squares(
//    CHECK-NOT: complex.
//        CHECK: llvm.mul %{{.+}}, %{{.+}} : i64
//        CHECK: !llvm.struct<(f64, f64)>
// DEVICE-LABEL: llvm.func @squares_0(
//  DEVICE-SAME: nvvm.kernel
//   DEVICE-NOT: complex.
//       DEVICE: !llvm.struct<(f64, f64)>
//           IR: define i32 @squares(
tai.kernel @squares(%a: f64, %n: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f64
    %1 = complex.create %0, %a : complex<f64>
    %2 = complex.mul %1, %1 : complex<f64>
    %3 = complex.add %2, %1 : complex<f64>
    %4 = complex.re %3 : complex<f64>
    %5 = index.mul %i, %n
    %6 = arith.index_cast %5 : index to i64
    %7 = arith.sitofp %6 : i64 to f64
    %8 = arith.addf %4, %7 : f64
    tai.store %8, @y[%i] : f64
  }
  tai.return
}
