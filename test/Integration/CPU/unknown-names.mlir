// RUN: split-file %s %t
// RUN: not tai-run %t/kernel.mlir 2>&1 | FileCheck %s --check-prefix=KERNEL
// RUN: not tai-run %t/kernel.mlir --kernel=nothing 2>&1 | FileCheck %s --check-prefix=KERNEL
// RUN: not tai-run %t/no-main.mlir 2>&1 | FileCheck %s --check-prefix=MAIN
// RUN: not tai-run %t/no-main.mlir --kernel=nothing 2>&1 | FileCheck %s --check-prefix=OPTION
// RUN: not tai-run %t/no-main.mlir --kernel=k --print-field=@q 2>&1 | FileCheck %s --check-prefix=FIELD
// RUN: tai-run %t/no-main.mlir --kernel=@k --print-field=@x | FileCheck %s --check-prefix=VALUE
// RUN: not tai-run %t/no-main.mlir --kernel=k --arch=tpu 2>&1 | FileCheck %s --check-prefix=ARCH
// RUN: not tai-run %t/missing.mlir 2>&1 | FileCheck %s --check-prefix=MISSING

// KERNEL: kernel.mlir:2:{{[0-9]+}}: error: {{.*}}stepp
// MAIN: error: the file holds no 'func.func @main'
// OPTION: error: the file holds no kernel 'nothing'
// FIELD: error: there is no field 'q'
// VALUE: @x : f32 = 0.1
// ARCH: error: there is no arch 'tpu'; there are cpu, cuda and interpreter
// MISSING: error: cannot read '{{.*}}missing.mlir'

//--- kernel.mlir
func.func @main() {
  tai.launch @stepp() : () -> ()
  return
}

//--- no-main.mlir
tai.tree @t : !tai.root<{x: f32}>
tai.field @x = @t["x"] : f32, rank 0
tai.kernel @k() {
  %c = arith.constant 0.1 : f32
  tai.store %c, @x[] : f32
  tai.return
}
