// RUN: tai-opt %s --verify-diagnostics --tai-convert-to-llvm
// RUN: sed -e 's/^llvm.func/gpu.module @m { llvm.func/' %s > %t.mlir
// RUN: echo '}' >> %t.mlir
// RUN: tai-opt %t.mlir --verify-diagnostics --tai-convert-to-nvvm=emulated=true

// The lowered kernel has its modes in a text, which no verifier reads.
// expected-error @+1 {{there is no mode 'math=exact'; there are}}
llvm.func @lowered() attributes {passthrough = [["tai.modes", "ftz=true,math=exact"]]} {
  llvm.return
}
