// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-convert-to-llvm

// A loop inside would become several blocks, which the kernel cannot hold.
// expected-error @+1 {{'tai.kernel' op reaches the last conversion; expects convert-tai-to-scf to run before}}
tai.kernel @loop(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.for %i = %c0 to %n step %c1 {
  }
  tai.return
}
