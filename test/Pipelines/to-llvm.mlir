// RUN: tai-opt %s --tai-to-llvm | FileCheck %s
// RUN: tai-opt %s --tai-to-llvm | tai-translate --mlir-to-llvmir | FileCheck %s --check-prefix=IR
// RUN: tai-opt %s --tai-to-llvm="debug=true" | FileCheck %s --check-prefix=DEBUG
// RUN: tai-opt %s --tai-to-llvm="opt-level=0" | tai-translate --mlir-to-llvmir | FileCheck %s --check-prefix=IR
// RUN: tai-opt --help | FileCheck %s --check-prefix=HELP

// From a kernel to LLVM IR in one pipeline.

// HELP-DAG: --tai-autodiff
// HELP-DAG: --tai-to-llvm
// HELP: --bounds={{.+}} Semantics of out-of-range indices that depend on data
// HELP: --bounds-check {{.+}} The same as bounds=check
// HELP: --deterministic {{.+}} Make results bit-identical

// Two layouts, one program.
tai.tree @flat : !tai.root<dense<[i: 128, j: 64], {x: vector<2xf32>}>, dense<[i: 128, j: 64], {y: f32}>, {loss: f32}>
tai.field @x = @flat["x"] : vector<2xf32>, rank 2
tai.field @y = @flat["y"] : f32, rank 2
tai.field @loss = @flat["loss"] : f32, rank 0

// CHECK-LABEL: llvm.func @norms(
//  CHECK-SAME:     %{{.+}}: !llvm.ptr) -> i32
//       CHECK:   llvm.call @tai_rt_parallel_for
// CHECK-LABEL: llvm.func internal @norms.loop0(
//       CHECK:   llvm.intr.sqrt
//       CHECK:   llvm.return
//   CHECK-NOT: {{ (arith|scf|cf|vector|math|tai|func)[.]}}
//          IR: define i32 @norms(ptr %0)
//          IR: define internal void @norms.loop0(ptr %0, ptr %1, i64 %2, i64 %3, i64 %4)
//          IR: call contract float @llvm.sqrt.f32
//          IR: define i32 @main(ptr %0)
//       DEBUG: llvm.call @tai_rt_fail
tai.kernel @norms(%scale: f32) {
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : vector<2xf32>
    %1 = tai.norm %0 : vector<2xf32>
    %2 = func.call @scaled(%1, %scale) : (f32, f32) -> f32
    tai.store %2, @y[%i, %j] : f32
    %3 = tai.atomic add %2, @loss[] : f32
  }
  tai.return
}

// Helpers go into their callers.
func.func private @scaled(%x: f32, %scale: f32) -> f32 {
  %0 = arith.mulf %x, %scale : f32
  return %0 : f32
}

func.func @main() {
  %0 = arith.constant 2.0 : f32
  tai.launch @norms(%0) : (f32) -> ()
  return
}
