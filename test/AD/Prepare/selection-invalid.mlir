// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-make-adjoint=kernel=f
// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-forward-diff=kernel=f

// expected-error @+1 {{cannot differentiate '@f', which has no body here}}
func.func private @f(%x: memref<4xf64>)

// -----

// expected-error @+1 {{cannot differentiate a 'llvm.func'; expects a 'func.func' or a 'tai.kernel'}}
llvm.func @f(%x: f64) {
  llvm.return
}
