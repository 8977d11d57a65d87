// Passes are found under the names they had, with the same options, and say so.
//
// RUN: tai-opt %s --tai-strip-loops=min-iterations=4096 -o %t.old 2>&1 | FileCheck %s
// RUN: tai-opt %s --tai-coarsen-threads=min-iterations=4096 -o %t.new
// RUN: diff %t.old %t.new
// RUN: FileCheck %s --check-prefix=COARSE < %t.old
// RUN: tai-opt %s --pass-pipeline="builtin.module(tai-split-loops,tai-split-interior,tai-gather-accumulations,tai-spread-accumulations,tai-forward-stores)" -o %t.all
// RUN: not tai-opt %s --tai-strip-loops=iterations=1 2>&1 | FileCheck %s --check-prefix=OPTION
// RUN: tai-opt %s --tai-lower-layout --convert-tai-to-host 2>&1 | FileCheck %s --check-prefix=HOST
// RUN: tai-opt %s --tai-make-adjoint=takes | FileCheck %s --check-prefix=ZEROES

// CHECK: note: the pass 'tai-strip-loops' is called 'tai-coarsen-threads' now
// COARSE: to (%{{.+}}, %c32)
// OPTION: no such option iterations
// HOST-NOT: note:
// HOST: llvm.func
// ZEROES: tai.kernel @copy_grad() attributes {{.*}}zeroes_adjoint

tai.tree @t : !tai.root<dense<[i: 64, j: 128], {x: f32}>, dense<[i: 64, j: 128], {y: f32}>>
tai.field @x = @t["x"] : f32, rank 2
tai.field @y = @t["y"] : f32, rank 2

tai.kernel @copy() {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  %c128 = arith.constant 128 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c64, %c128) {
    %v = tai.load @x[%i, %j] : f32
    tai.store %v, @y[%i, %j] : f32
  }
  tai.return
}
