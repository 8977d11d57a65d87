// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-verify-llvm

// Nothing to say.
llvm.func @fine() {
  llvm.return
}

// -----

llvm.func @left(%a: f32) attributes {passthrough = ["tai.lowered"]} {
  // expected-error @+1 {{'arith.negf' op was not lowered to the LLVM dialect}}
  %0 = arith.negf %a : f32
  llvm.return
}
